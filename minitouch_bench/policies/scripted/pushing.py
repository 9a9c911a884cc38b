"""Pushing by script: go round the object, then push it towards the target.

The 50 kg cube gives way badly to a push square on a face that the fingers meet with their
tips side by side: they slide apart. A push 30 degrees off such a direction moves it, so the
object goes to its target in a zigzag where the straight way is one of those.
"""

import math
from typing import cast

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.scripted.controller import Controller
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.tasks import PUSHING
from minitouch_bench.tasks.pushing import Pushing

REACH_M = PROTOCOL.control.reach
WORKSPACE = PUSHING.workspace

OVERLAP_M = 0.001
"""How far the end effector stays below the object's top; the fingertips are 8 mm lower."""
ROUND_M = 0.085
"""Radius of the way round the object."""
BEHIND_M = 0.065
"""Distance from the object's middle at which a push begins."""
LANE_M = 0.012
"""A push begins when the fingers are this close to the line."""
LOST_M = 0.03
"""A push ends when they are further from it than this."""
TURN_RAD = 0.6
"""Angle covered by one step on the way round."""
ALIGNED_RAD = 0.4
WEAK_RAD = (0.0, math.pi / 2, -math.pi / 2)
"""Directions in which the cube hardly gives way."""
SLANT_RAD = math.radians(30.0)
ASTRAY_RAD = math.radians(50.0)
"""A push ends when the target lies further off its direction than this."""
STUCK_M = 0.003
RETREAT_STEPS = 2


class PushingController(Controller):
    """Choose a direction, go behind the object, push, and choose again when it went astray."""

    _direction: float | None = None
    _pushing = False
    _turn = 0.0
    _last: NDArray[np.float64] | None = None
    _retreat = 0

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (4,); fingers that are stuck back off first."""
        hand = self.hand
        if self._last is not None and math.dist(hand, self._last) < STUCK_M:
            self._retreat = RETREAT_STEPS
            self._give_up()
        self._last = hand
        place = self.object_state[:2]
        if self._retreat > 0:
            self._retreat -= 1
            from_object = hand[:2] - place
            return self._to(hand[:2] + REACH_M * from_object / max(np.abs(from_object).max(), 1e-6))
        return self._push(place, hand[:2])

    def _give_up(self) -> None:
        self._direction, self._pushing, self._turn = None, False, 0.0

    def _push(self, place: NDArray[np.float64], hand: NDArray[np.float64]) -> NDArray[np.float32]:
        target = np.array(cast(Pushing, self.environment.task).target)
        wanted = math.atan2(*(target - place)[::-1])
        astray = self._direction is not None and (
            abs(math.remainder(wanted - self._direction, math.tau)) > ASTRAY_RAD
        )
        if self._direction is None or astray:
            self._give_up()
            self._direction = _direction(wanted, place)
        ahead = np.array((math.cos(self._direction), math.sin(self._direction)))
        across = np.array((-ahead[1], ahead[0]))
        from_object = hand - place
        behind, aside = -float(from_object @ ahead), float(from_object @ across)
        self._pushing = behind > 0.0 and abs(aside) < (LOST_M if self._pushing else LANE_M)
        if self._pushing:
            self._turn = 0.0
            return self._to(hand + ahead * REACH_M - across * aside)
        return self._go_round(place, from_object, -ahead)

    def _go_round(
        self,
        place: NDArray[np.float64],
        from_object: NDArray[np.float64],
        away: NDArray[np.float64],
    ) -> NDArray[np.float32]:
        angle = math.atan2(from_object[1], from_object[0])
        wanted = math.atan2(away[1], away[0])
        if abs(math.remainder(wanted - angle, math.tau)) < ALIGNED_RAD:
            return self._to(place + away * BEHIND_M)
        if self._turn == 0.0:
            self._turn = min((1.0, -1.0), key=lambda turn: _cost(place, angle, wanted, turn))
        arc = ((wanted - angle) * self._turn) % math.tau
        ahead = angle + self._turn * min(arc, TURN_RAD)
        return self._to(_on_circle(place, ahead))

    def _to(self, place: NDArray[np.float64]) -> NDArray[np.float32]:
        task = cast(Pushing, self.environment.task)
        top = task.model.highest_point(self.client, task.target_body)
        height = max(WORKSPACE.low[2], min(top - OVERLAP_M, WORKSPACE.high[2]))
        return self.toward((*place, height), finger=-1.0)


def _direction(wanted: float, place: NDArray[np.float64]) -> float:
    """Return the direction (rad) to push in: ``wanted``, or slanted where that is weak."""
    for weak in WEAK_RAD:
        off = math.remainder(wanted - weak, math.tau)
        if abs(off) < SLANT_RAD:
            slants = (weak + SLANT_RAD, weak - SLANT_RAD)
            return min(slants, key=lambda angle: _slant_cost(place, angle, wanted))
    return wanted


def _slant_cost(place: NDArray[np.float64], angle: float, wanted: float) -> float:
    start = place - BEHIND_M * np.array((math.cos(angle), math.sin(angle)))
    outside = not WORKSPACE.holds(float(start[0]), float(start[1]))
    return abs(math.remainder(wanted - angle, math.tau)) + 10.0 * outside


def _on_circle(center: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    return center + ROUND_M * np.array((math.cos(angle), math.sin(angle)))


def _cost(place: NDArray[np.float64], angle: float, wanted: float, turn: float) -> float:
    """Return the length of a way round (rad), much longer where it leaves the workspace."""
    arc = ((wanted - angle) * turn) % math.tau
    points = [_on_circle(place, angle + turn * part * arc) for part in np.linspace(0.1, 1.0, 12)]
    outside = sum(not WORKSPACE.holds(float(x), float(y)) for x, y in points)
    return arc + 10.0 * outside
