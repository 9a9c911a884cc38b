"""Pick-up by script: grasp the object where it is narrow between the fingers, and lift."""

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.scripted.controller import Controller

OPEN, CLOSE = 1.0, -1.0
HOVER_M = 0.02
"""Height of the fingertips above the object on the way to it."""
FINGERTIP_M = 0.008
"""How far the fingertips reach below the end effector."""
NEAR_M = 0.004
CLOSING_STEPS = 4
NUDGE = 0.05
"""A step without motion lasts one tick; one of 3 mm gives the fingers time to close."""


class PickUpController(Controller):
    """Hover, descend, close, lift."""

    _closing = 0

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (4,)."""
        if self._closing > 0:
            return self._close_and_lift()
        grasp = self._grasp()
        top = self.client.bounds(self.environment.task.target_body)[1][2]
        hand = self.hand
        if np.abs(hand[:2] - grasp[:2]).max() > NEAR_M:
            hover = max(top + HOVER_M + FINGERTIP_M, 0.06)
            clear = hand[2] > top + FINGERTIP_M + 0.005
            goal = (*grasp[:2], hover) if clear else (*hand[:2], hover)
            return self.toward(goal, finger=OPEN)
        if hand[2] > grasp[2] + NEAR_M:
            return self.toward(grasp, finger=OPEN)
        self._closing = 1
        return self._close_and_lift()

    def _close_and_lift(self) -> NDArray[np.float32]:
        self._closing += 1
        if self._closing <= CLOSING_STEPS:
            nudge = NUDGE if self._closing % 2 else -NUDGE
            return np.array((0.0, 0.0, nudge, CLOSE), np.float32)
        return np.array((0.0, 0.0, 0.5, CLOSE), np.float32)

    def _grasp(self) -> NDArray[np.float64]:
        """Return where to close the fingers, float64 (3,) in m."""
        low, high = self.client.bounds(self.environment.task.target_body)
        height = max(FINGERTIP_M + 0.002, high[2] - 0.025)
        return np.array(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, height))
