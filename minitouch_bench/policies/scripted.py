"""The scripted policy: it reads the simulator's state, and every table says so.

It acts through the same actions as any policy, with no force and no teleport of its own, and
so proves that each task can be solved.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Observation
from minitouch_bench.protocol.minitouch import OPENING, PROTOCOL, PUSHING
from minitouch_bench.shapegen.geometry import rotation_matrix, surface_points
from minitouch_bench.shapegen.grips import plan_grasp
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import Opening, PickUp, Pushing

REACH_M = PROTOCOL.control.reach
TABLE_TOP_M = PROTOCOL.physics.table_top
WORKSPACE, CUBE_SIDE_M = PUSHING.workspace, PUSHING.cube.side
CABINET = OPENING.cabinet
OPEN, CLOSE = 1.0, -1.0

Point = NDArray[np.float64]


class Controller(ABC):
    """A controller of one episode, which may look at the whole simulator."""

    def __init__(self, environment: MiniTouchEnv) -> None:
        self.environment = environment
        self.client = environment.client

    @abstractmethod
    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 of the task's size, in [-1, 1]."""

    @property
    def hand(self) -> NDArray[np.float64]:
        """End-effector position, float64 (3,) in m."""
        return np.array(self.environment.arm.position)

    @property
    def object_state(self) -> NDArray[np.float64]:
        """The object's position, float64 (3,) in m, or the door's angle, (1,) in rad."""
        return self.environment.task.object_state(self.client)

    def toward(
        self, goal: Sequence[float] | NDArray[np.float64], *, finger: float = 0.0, yaw: float = 0.0
    ) -> NDArray[np.float32]:
        """Return the action towards ``goal`` (m), the ``finger`` number and a ``yaw`` (rad)."""
        offset = (np.asarray(goal) - self.hand) / REACH_M
        offset /= max(1.0, float(np.abs(offset).max()))
        action = [*offset, finger]
        if self.environment.task.spec.arm.faces_door:
            turn = (yaw - self.environment.arm.yaw) / PROTOCOL.control.yaw_reach
            action.append(float(np.clip(turn, -1.0, 1.0)))
        return np.array(action, np.float32)


class PlayingController(Controller):
    """Press the closed fingers against the object: drive at its middle, low."""

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (4,)."""
        x, y, _ = self.object_state
        return self.toward((x, y, 0.0))


class OpeningController(Controller):
    """Go beside the door, in, behind it, and pull.

    The half of the cabinet beside the door is open. The fingers go in there, pointing towards the
    hinge, slide behind the door, and pull; they aim a little ahead of the door's angle.
    """

    HEIGHT_M = 0.125
    TURN_RAD = math.pi / 4
    """Yaw of the gripper: its fingers point 45 degrees towards the hinge."""
    AHEAD_RAD = 0.12
    """How far ahead of the door's angle the fingers aim."""
    BEHIND_M = 0.030
    """Distance of the end effector from the door's middle plane, behind it, on the way in."""
    HOOK_M = 0.022
    """The same while it pulls: closer than it can get, hence the pressure."""
    ENTRY_M = 0.055
    """How far beyond the free edge the end effector passes the door."""
    GRIP_M = 0.455
    """Distance from the hinge's axis at which the door is pulled."""
    SLIDE_M = 0.02

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (5,)."""
        angle = float(self.object_state[0])
        along, behind = self._in_door_frame(angle)
        edge = CABINET.door_width - CABINET.door_overhang
        turned = self.environment.arm.yaw > self.TURN_RAD - 0.1
        if along < edge + 0.01 and behind > 0.012 and turned:
            return self._to(
                angle + self.AHEAD_RAD, self.GRIP_M - 0.06 * math.sin(angle), self.HOOK_M
            )
        if along < edge + self.ENTRY_M - self.SLIDE_M and behind < self.BEHIND_M - 0.01:
            return self._to(angle, edge + self.ENTRY_M + 0.02, min(behind, -0.08))
        if behind < self.BEHIND_M - 0.008 or not turned:
            return self._to(
                angle, edge + self.ENTRY_M, self.BEHIND_M if turned else min(behind, -0.05)
            )
        return self._to(angle, self.GRIP_M + self.SLIDE_M, self.BEHIND_M)

    def _in_door_frame(self, angle: float) -> tuple[float, float]:
        """Return how far the hand is from the hinge along the door, and behind the door (m)."""
        hinge_x, hinge_y = self._hinge()
        sine, cosine = math.sin(angle), math.cos(angle)
        x, y = self.hand[0] - hinge_x, self.hand[1] - hinge_y
        return float(-sine * x + cosine * y), float(cosine * x + sine * y)

    def _hinge(self) -> tuple[float, float]:
        front, middle = cast(Opening, self.environment.task).position
        return front + CABINET.door_thickness / 2, middle + CABINET.hinge_y

    def _to(self, angle: float, along: float, behind: float) -> NDArray[np.float32]:
        hinge_x, hinge_y = self._hinge()
        sine, cosine = math.sin(angle), math.cos(angle)
        x = hinge_x - along * sine + behind * cosine
        y = hinge_y + along * cosine + behind * sine
        return self.toward((x, y, self.HEIGHT_M), finger=-1.0, yaw=self.TURN_RAD)


class PickUpController(Controller):
    """Grasp the object where it is narrow between the fingers, and lift it.

    After a grasp that failed the controller tries another place.
    """

    HOVER_M = 0.02
    """Height of the fingertips above the object on the way to it."""
    FINGERTIP_M = 0.008
    """How far the fingertips reach below the end effector."""
    NEAR_M = 0.002
    POINT_SPACING_M = 0.003
    LOST_ABOVE_M, LOST_BELOW_M = 0.055, TABLE_TOP_M + 0.01
    CLOSING_STEPS = 4
    NUDGE = 0.02
    """A step without motion lasts one tick; one of 1 mm along the pads gives them time to close."""
    LIFT = 0.15
    """Slow: some shapes reach only a few millimeters up between the pads."""

    def __init__(self, environment: MiniTouchEnv) -> None:
        super().__init__(environment)
        self._closing = 0
        self._place: NDArray[np.float64] | None = None
        self._top = 0.0
        self._tried: list[float] = []

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (4,)."""
        if self._closing > 0 and self._lost():
            self._closing, self._place = 0, None
        if self._closing > 0:
            return self._close_and_lift()
        grasp = self._grasp()
        top, hand = self._top, self.hand
        if np.abs(hand[:2] - grasp[:2]).max() > self.NEAR_M:
            hover = max(top + self.HOVER_M + self.FINGERTIP_M, 0.035)
            clear = hand[2] > top + self.FINGERTIP_M + 0.005
            goal = (*grasp[:2], hover) if clear else (*hand[:2], hover)
            return self.toward(goal, finger=OPEN)
        if hand[2] > grasp[2] + self.NEAR_M:
            return self.toward(grasp, finger=OPEN)
        self._closing = 1
        return self._close_and_lift()

    def _close_and_lift(self) -> NDArray[np.float32]:
        self._closing += 1
        if self._closing <= self.CLOSING_STEPS:
            nudge = self.NUDGE if self._closing % 2 else -self.NUDGE
            return np.array((0.0, nudge, 0.0, CLOSE), np.float32)
        return np.array((0.0, 0.0, self.LIFT, CLOSE), np.float32)

    def _lost(self) -> bool:
        """Tell whether the hand has gone up and left the object on the table."""
        task = cast(PickUp, self.environment.task)
        lowest, _ = task.model.heights(self.client, task.target_body)
        return bool(self.hand[2] > self.LOST_ABOVE_M and lowest < self.LOST_BELOW_M)

    def _grasp(self) -> NDArray[np.float64]:
        """Return where to close the fingers, float64 (3,) in m."""
        if self._place is None:
            task = cast(PickUp, self.environment.task)
            position, orientation = self.client.pose(task.target_body)
            points = surface_points(task.model.surface, self.POINT_SPACING_M)
            height = position[2] - TABLE_TOP_M
            above_table = points @ rotation_matrix(orientation).T + (0.0, 0.0, height)
            # The planner's pads close along y, the hand's along the world's x.
            lowest = task.spec.workspace.low[2] - TABLE_TOP_M
            grasp = plan_grasp(above_table[:, (1, 0, 2)], lowest, self._tried, deep=True)
            self._tried.append(grasp.x)
            self._place = np.array(
                (position[0] + grasp.y, position[1] + grasp.x, grasp.z + TABLE_TOP_M)
            )
            self._top = float(above_table[:, 2].max()) + TABLE_TOP_M
        return self._place


class PushingController(Controller):
    """Go behind the object, low, push it, and choose again.

    The 50 kg cube does not slide under fingers that press on its side, for they press it down too.
    It tips over its far edge when they rise as they push, and so moves by its own side, 5 cm; it
    goes to its target along x and y, square on its faces. A shape is light: it slides straight
    there, a little at each step.
    """

    LOW_M, HIGH_M = WORKSPACE.low[2], WORKSPACE.high[2]
    """Heights of the end effector: where a push begins, and where it passes over the object."""
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

    def __init__(self, environment: MiniTouchEnv) -> None:
        super().__init__(environment)
        self._task = cast(Pushing, environment.task)
        self._heavy = self._task.model.is_task_cube
        self._ahead: Point = np.zeros(2)
        """The direction of the push, (0, 0) before it is chosen."""
        self._pushes = 0
        self._last: Point = np.zeros(3)

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (4,)."""
        hand, middle = self.hand, self.object_state[:2]
        if self._pushes and self._over(hand[:2] - middle):
            self._ahead, self._pushes = np.zeros(2), 0
        if not self._heavy or not self._ahead.any():
            self._ahead = self._direction(middle)
        start = np.clip(middle - self.BEHIND_M * self._ahead, WORKSPACE.low[:2], WORKSPACE.high[:2])
        behind = np.abs(hand[:2] - start).max() < self.NEAR_M and hand[2] < self.LOW_M + self.NEAR_M
        stuck = math.dist(hand, self._last) < self.STUCK_M
        self._last = hand
        if self._pushes or behind:
            self._pushes += 1
            return self._push(hand, middle)
        return self._go(hand, start, middle, stuck)

    def _over(self, from_object: Point) -> bool:
        """Tell whether the push is over: done, missed or without effect."""
        behind = -float(from_object @ self._ahead)
        aside = abs(float(from_object @ _across(self._ahead)))
        return (
            not 0.0 <= behind <= self.FURTHEST_BEHIND_M
            or aside > (self.CUBE_LOST_M if self._heavy else self.SHAPE_LOST_M)
            or (self._heavy and self._pushes > self.PUSH_STEPS)
        )

    def _push(self, hand: Point, middle: Point) -> NDArray[np.float32]:
        across = _across(self._ahead)
        goal = hand[:2] + self._ahead * (REACH_M if self._heavy else self.SLIDE_M)
        goal += across * float((middle - hand[:2]) @ across)
        _, top = self._task.model.heights(self.client, self._task.target_body)
        return self.toward(
            (*goal, min(top, self.HIGH_M) if self._heavy else self.LOW_M), finger=-1.0
        )

    def _go(self, hand: Point, start: Point, middle: Point, stuck: bool) -> NDArray[np.float32]:
        """Go to where the push begins, over the object where it is in the way."""
        there = np.abs(start - hand[:2]).max() < self.NEAR_M
        if not stuck and (there or self._clear(hand[:2], start, middle)):
            return self.toward((*start, self.LOW_M), finger=-1.0)
        above = hand[2] > self.HIGH_M - self.STUCK_M
        return self.toward((*(start if above else hand[:2]), self.HIGH_M), finger=-1.0)

    def _clear(self, hand: Point, start: Point, middle: Point) -> bool:
        """Tell whether the straight way to the start passes beside the object."""
        way = start - hand
        part = np.clip((middle - hand) @ way / max(float(way @ way), 1e-9), 0.0, 1.0)
        return bool(np.abs(hand + part * way - middle).max() > self.CLEAR_M)

    def _direction(self, middle: Point) -> Point:
        """Return the direction, a unit vector, in which to push next.

        A shape straight to its target; the cube along x or y, the longer way first unless
        there is too little room behind it, and before that a way for which there soon might be.
        """
        remaining = np.array(self._task.target) - middle
        if not self._heavy:
            return remaining / float(np.hypot(*remaining))

        def gain(ahead: Point) -> float:
            way, room = float(remaining @ ahead), _room(middle, ahead)
            if room < self.LEAST_BEHIND_M:
                return -1.0
            return way + (1.0 if room < self.SCARCE_M and way > CUBE_SIDE_M / 2 else 0.0)

        signs = np.copysign(1.0, remaining)
        return max(np.array((signs[0], 0.0)), np.array((0.0, signs[1])), key=gain)


def _across(ahead: Point) -> Point:
    return np.array((-ahead[1], ahead[0]))


def _room(middle: Point, ahead: Point) -> float:
    """Return how far behind ``middle`` (m) the workspace ends; ``ahead`` is along x or y."""
    edge = np.where(ahead > 0.0, WORKSPACE.low[:2], WORKSPACE.high[:2])
    return float((middle - edge) @ ahead)


CONTROLLERS: dict[str, type[Controller]] = {
    "playing": PlayingController,
    "pushing": PushingController,
    "opening": OpeningController,
    "pick-up": PickUpController,
}


class ScriptedPolicy:
    """The policy of a task's controller; ``world_of`` gives the simulated world of a task."""

    def __init__(self, world_of: Callable[[str], MiniTouchEnv]) -> None:
        self._world_of = world_of

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode, in the state that the task's world is in."""
        self._controller = make_controller(self._world_of(task))

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Ask the controller, which looks past the observation."""
        return self._controller.act()


def make_controller(environment: MiniTouchEnv) -> Controller:
    """Return the controller of one episode of the environment's task."""
    return CONTROLLERS[environment.task.spec.name](environment)
