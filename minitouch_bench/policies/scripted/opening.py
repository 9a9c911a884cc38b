"""Opening by script: reach behind the door's free edge with turned fingers, then follow its arc.

The half of the cabinet beside the door is open. The fingers go in there, pointing towards the
hinge, slide behind the door, and pull; they aim a little ahead of the door's angle.
"""

import math
from typing import cast

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.scripted.controller import Controller
from minitouch_bench.protocol.tasks import OPENING
from minitouch_bench.tasks.opening import Opening

CABINET = OPENING.cabinet

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


class OpeningController(Controller):
    """Go beside the door, in, behind it, and pull."""

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (5,)."""
        angle = float(self.object_state[0])
        along, behind = self._in_door_frame(angle)
        edge = CABINET.door_width - CABINET.door_overhang
        turned = self.environment.arm.yaw > TURN_RAD - 0.1
        if along < edge + 0.01 and behind > 0.012 and turned:
            return self._to(angle + AHEAD_RAD, GRIP_M - 0.06 * math.sin(angle), HOOK_M)
        if along < edge + ENTRY_M - SLIDE_M and behind < BEHIND_M - 0.01:
            return self._to(angle, edge + ENTRY_M + 0.02, min(behind, -0.08))
        if behind < BEHIND_M - 0.008 or not turned:
            return self._to(angle, edge + ENTRY_M, BEHIND_M if turned else min(behind, -0.05))
        return self._to(angle, GRIP_M + SLIDE_M, BEHIND_M)

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
        return self.toward((x, y, HEIGHT_M), finger=-1.0, yaw=TURN_RAD)
