"""Pushing by script: go behind the object, low, then push it.

The 50 kg cube does not slide under fingers that press on its side, for they press it down too.
It tips over its far edge when they rise as they push, and so moves by its own side, 5 cm; it
goes to its target along x and y, square on its faces. A shape is light: it slides straight
there, a little at each step.
"""

import math
from typing import cast

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.scripted.controller import Controller
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import CUBE
from minitouch_bench.protocol.tasks import PUSHING
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.pushing import Pushing

REACH_M = PROTOCOL.control.reach
WORKSPACE = PUSHING.workspace
CUBE_SIDE_M = PUSHING.cube.side

LOW_M, HIGH_M = WORKSPACE.low[2], WORKSPACE.high[2]
"""Heights of the end effector: where a push begins, and where the fingers pass over the object."""
BEHIND_M = 0.06
"""Distance from the object's middle at which a push begins."""
FURTHEST_BEHIND_M = 0.08
LEAST_BEHIND_M = 0.038
"""The same where the workspace ends: the fingers just fit in."""
SCARCE_M = 0.08
"""With less room than this behind the cube, a push from there comes first."""
CLEAR_M = 0.055
"""At this distance from the object's middle, along x or y, low fingers do not touch it."""
NEAR_M = 0.008
STUCK_M = 0.003
SLIDE_M = 0.015
"""How far a shape is pushed in one step."""
CUBE_LOST_M, SHAPE_LOST_M = 0.03, 0.015
"""A push ends when the fingers are this far beside the line through the object's middle."""
PUSH_STEPS = 8
"""A push of the cube ends after this many steps in any case."""

Vector = NDArray[np.float64]


class PushingController(Controller):
    """Choose a direction, go behind the object, push, and choose again."""

    def __init__(self, environment: MiniTouchEnv) -> None:
        super().__init__(environment)
        self._task = cast(Pushing, environment.task)
        self._heavy = self._task.model.name == CUBE
        self._ahead: Vector = np.zeros(2)
        """The direction of the push, (0, 0) before it is chosen."""
        self._pushes = 0
        self._last: Vector = np.zeros(3)

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (4,)."""
        hand, middle = self.hand, self.object_state[:2]
        if self._pushes and self._over(hand[:2] - middle):
            self._ahead, self._pushes = np.zeros(2), 0
        if not self._heavy or not self._ahead.any():
            self._ahead = self._direction(middle)
        start = np.clip(middle - BEHIND_M * self._ahead, WORKSPACE.low[:2], WORKSPACE.high[:2])
        behind = np.abs(hand[:2] - start).max() < NEAR_M and hand[2] < LOW_M + NEAR_M
        stuck = math.dist(hand, self._last) < STUCK_M
        self._last = hand
        if self._pushes or behind:
            self._pushes += 1
            return self._push(hand, middle)
        return self._go(hand, start, middle, stuck)

    def _over(self, from_object: Vector) -> bool:
        """Tell whether the push is over: done, missed or without effect."""
        behind = -float(from_object @ self._ahead)
        aside = abs(float(from_object @ _across(self._ahead)))
        return (
            not 0.0 <= behind <= FURTHEST_BEHIND_M
            or aside > (CUBE_LOST_M if self._heavy else SHAPE_LOST_M)
            or (self._heavy and self._pushes > PUSH_STEPS)
        )

    def _push(self, hand: Vector, middle: Vector) -> NDArray[np.float32]:
        across = _across(self._ahead)
        goal = hand[:2] + self._ahead * (REACH_M if self._heavy else SLIDE_M)
        goal += across * float((middle - hand[:2]) @ across)
        top = self._task.model.highest_point(self.client, self._task.target_body)
        return self.toward((*goal, min(top, HIGH_M) if self._heavy else LOW_M), finger=-1.0)

    def _go(self, hand: Vector, start: Vector, middle: Vector, stuck: bool) -> NDArray[np.float32]:
        """Go to where the push begins, over the object where it is in the way."""
        there = np.abs(start - hand[:2]).max() < NEAR_M
        if not stuck and (there or _clear(hand[:2], start, middle)):
            return self.toward((*start, LOW_M), finger=-1.0)
        above = hand[2] > HIGH_M - STUCK_M
        return self.toward((*(start if above else hand[:2]), HIGH_M), finger=-1.0)

    def _direction(self, middle: Vector) -> Vector:
        """Return the direction, a unit vector, in which to push next.

        A shape straight to its target; the cube along x or y, the longer way first unless
        there is too little room behind it, and before that a way for which there soon might be.
        """
        remaining = np.array(self._task.target) - middle
        if not self._heavy:
            return remaining / float(np.hypot(*remaining))

        def gain(ahead: Vector) -> float:
            way, room = float(remaining @ ahead), _room(middle, ahead)
            if room < LEAST_BEHIND_M:
                return -1.0
            return way + (1.0 if room < SCARCE_M and way > CUBE_SIDE_M / 2 else 0.0)

        signs = np.copysign(1.0, remaining)
        return max(np.array((signs[0], 0.0)), np.array((0.0, signs[1])), key=gain)


def _across(ahead: Vector) -> Vector:
    return np.array((-ahead[1], ahead[0]))


def _room(middle: Vector, ahead: Vector) -> float:
    """Return how far behind ``middle`` (m) the workspace ends; ``ahead`` is along x or y."""
    edge = np.where(ahead > 0.0, WORKSPACE.low[:2], WORKSPACE.high[:2])
    return float((middle - edge) @ ahead)


def _clear(hand: Vector, start: Vector, middle: Vector) -> bool:
    """Tell whether the straight way to the start passes beside the object."""
    way = start - hand
    part = np.clip((middle - hand) @ way / max(float(way @ way), 1e-9), 0.0, 1.0)
    return bool(np.abs(hand + part * way - middle).max() > CLEAR_M)
