"""Pushing by script: go round the cube, then push it along the line to the target."""

import math
from typing import cast

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.scripted.controller import Controller
from minitouch_bench.simulation.panda_arm import REACH_M
from minitouch_bench.tasks.pushing import WORKSPACE, Pushing

PUSH_HEIGHT_M = 0.018
ROUND_M = 0.08
"""Radius of the way round the object."""
BEHIND_M = 0.06
"""Distance from the object's middle at which a push begins."""
LANE_M = 0.012
"""A push goes on while the fingers are this close to the line."""
TURN_RAD = 0.6
"""Angle covered by one step on the way round."""
ALIGNED_RAD = 0.4
STUCK_M = 0.003
RETREAT_STEPS = 2
TILTED_M = 0.028
"""A middle this high means that the fingers have got under the cube: back off."""


class PushingController(Controller):
    """Keep behind the object, seen from the target."""

    _turn = 0.0
    _last: NDArray[np.float64] | None = None
    _retreat = 0

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (4,); fingers that are stuck back off first."""
        hand = self.hand
        if self._last is not None and math.dist(hand, self._last) < STUCK_M:
            self._retreat, self._turn = RETREAT_STEPS, 0.0
        self._last = hand
        if self._retreat > 0:
            self._retreat -= 1
            from_object = hand[:2] - self.object_state[:2]
            return self._to(hand[:2] + REACH_M * from_object / max(np.abs(from_object).max(), 1e-6))
        return self._push()

    def _push(self) -> NDArray[np.float32]:
        target = np.array(cast(Pushing, self.environment.task).target)
        place, hand = self.object_state, self.hand[:2]
        away = (place[:2] - target) / math.dist(place[:2], target)
        across = np.array((-away[1], away[0]))
        from_object = hand - place[:2]
        along, aside = float(from_object @ away), float(from_object @ across)
        if along > 0.0 and abs(aside) < LANE_M:
            self._turn = 0.0
            if place[2] > TILTED_M:
                return self._to(hand + away * REACH_M)
            return self._to(hand - away * REACH_M - across * aside)
        return self._go_round(place[:2], from_object, away)

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
        return self.toward((*place, PUSH_HEIGHT_M))


def _on_circle(center: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    return center + ROUND_M * np.array((math.cos(angle), math.sin(angle)))


def _cost(place: NDArray[np.float64], angle: float, wanted: float, turn: float) -> float:
    """Return the length of a way round (rad), much longer where it leaves the workspace."""
    arc = ((wanted - angle) * turn) % math.tau
    points = [_on_circle(place, angle + turn * part * arc) for part in np.linspace(0.1, 1.0, 12)]
    outside = sum(not WORKSPACE.holds(float(x), float(y)) for x, y in points)
    return arc + 10.0 * outside
