"""Opening by script: press the closed fingers against the handle's free side, along its arc.

The handle stands in front of the hinge, so pressing it towards the hinge turns the door; the
fingers follow the door's angle, a little ahead of it.
"""

import math
from typing import cast

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.scripted.controller import Controller
from minitouch_bench.tasks.opening import CABINET, Opening

HEIGHT_M = 0.125
LOWEST_M = 0.11
AHEAD_RAD = 0.08
"""How far ahead of the door's angle the fingers aim."""
PRESS_M = 0.016
"""Where they aim, from the handle's middle: closer than they can get, hence the pressure."""
BESIDE_M = 0.034
IN_FRONT_M = 0.05


class OpeningController(Controller):
    """Go beside the handle, then sweep."""

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (5,)."""
        angle = float(self.object_state[0])
        handle, outward, opening = self._frame(angle)
        hand = self.hand
        if hand[2] < LOWEST_M:
            return self._to(np.array((min(hand[0], 0.66), max(hand[1], handle[1] + 0.07))))
        from_handle = hand[:2] - handle
        beside, in_front = float(from_handle @ outward), float(from_handle @ opening)
        if in_front < 0.018 and beside > 0.012:
            ahead, ahead_outward, _ = self._frame(angle + AHEAD_RAD)
            return self._to(ahead + ahead_outward * PRESS_M)
        if 0.03 <= beside <= 0.06:
            return self._to(handle + outward * BESIDE_M)
        if beside < 0.03 and in_front < 0.045:
            return self._to(handle + opening * 0.07 + outward * beside)
        return self._to(handle + opening * IN_FRONT_M + outward * 0.04)

    def _frame(self, angle: float) -> tuple[NDArray[np.float64], ...]:
        """Return the handle's middle, the way to the door's free edge, and the way it opens."""
        place = CABINET.handle_place(*cast(Opening, self.environment.task).place, angle)
        sine, cosine = math.sin(angle), math.cos(angle)
        return np.array(place), np.array((-sine, cosine)), np.array((-cosine, -sine))

    def _to(self, place: NDArray[np.float64]) -> NDArray[np.float32]:
        return self.toward((*place, HEIGHT_M))
