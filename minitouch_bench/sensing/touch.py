"""The touch vector: 11 numbers, in the order of the paper's supplement."""

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.simulation.panda_arm import PandaArm

POSITION = slice(0, 3)
"""End-effector position (m)."""
OPENINGS = slice(3, 5)
"""Finger openings, left and right, 0 (closed) to 1 (0.04 m)."""
FORCES = slice(5, 11)
"""Force at the finger joints (N): left x, y, z, then right x, y, z."""


def read_touch(arm: PandaArm, force_limit: float) -> NDArray[np.float32]:
    """Return the touch vector, float32 (11,), forces clipped to ``force_limit`` (N)."""
    touch = np.empty(PROTOCOL.observation.touch_size, np.float32)
    touch[POSITION] = arm.position
    # A squeezed finger reads a hair outside its joint's range.
    touch[OPENINGS] = np.clip(
        np.divide(arm.finger_positions(), PROTOCOL.control.finger_open), 0.0, 1.0
    )
    left, right = arm.finger_forces()
    touch[FORCES] = np.clip((*left, *right), -force_limit, force_limit)
    return touch
