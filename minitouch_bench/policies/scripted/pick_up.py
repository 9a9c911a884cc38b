"""Pick-up by script: grasp the object where it is narrow between the fingers, and lift."""

from typing import cast

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.scripted.controller import Controller
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.shapegen.grips import plan_deep_grasp
from minitouch_bench.shapegen.mesh import surface_points
from minitouch_bench.shapegen.poses import rotation_matrix
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.pick_up import PickUp

OPEN, CLOSE = 1.0, -1.0
HOVER_M = 0.02
"""Height of the fingertips above the object on the way to it."""
FINGERTIP_M = 0.008
"""How far the fingertips reach below the end effector."""
NEAR_M = 0.002
POINT_SPACING_M = 0.003
TABLE_TOP_M = PROTOCOL.physics.table_top
LOST_ABOVE_M, LOST_BELOW_M = 0.055, TABLE_TOP_M + 0.01
CLOSING_STEPS = 4
NUDGE = 0.02
"""A step without motion lasts one tick; one of 1 mm along the pads gives them time to close."""
LIFT = 0.15
"""Slow: some shapes reach only a few millimeters up between the pads."""


class PickUpController(Controller):
    """Hover, descend, close, lift; after a grasp that failed, try another place."""

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
        if np.abs(hand[:2] - grasp[:2]).max() > NEAR_M:
            hover = max(top + HOVER_M + FINGERTIP_M, 0.035)
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
            return np.array((0.0, nudge, 0.0, CLOSE), np.float32)
        return np.array((0.0, 0.0, LIFT, CLOSE), np.float32)

    def _lost(self) -> bool:
        """Tell whether the hand has gone up and left the object on the table."""
        task = cast(PickUp, self.environment.task)
        lowest = task.model.lowest_point(self.client, task.target_body)
        return bool(self.hand[2] > LOST_ABOVE_M and lowest < LOST_BELOW_M)

    def _grasp(self) -> NDArray[np.float64]:
        """Return where to close the fingers, float64 (3,) in m."""
        if self._place is None:
            task = cast(PickUp, self.environment.task)
            position, orientation = self.client.pose(task.target_body)
            points = surface_points(task.model.surface, POINT_SPACING_M)
            height = position[2] - TABLE_TOP_M
            above_table = points @ rotation_matrix(orientation).T + (0.0, 0.0, height)
            # The planner's pads close along y, the hand's along the world's x.
            lowest = task.spec.workspace.low[2] - TABLE_TOP_M
            grasp = plan_deep_grasp(above_table[:, (1, 0, 2)], lowest, self._tried)
            self._tried.append(grasp.x)
            self._place = np.array(
                (position[0] + grasp.y, position[1] + grasp.x, grasp.z + TABLE_TOP_M)
            )
            self._top = float(above_table[:, 2].max()) + TABLE_TOP_M
        return self._place
