"""The observation and its space."""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from minitouch_bench.sensing.camera import IMAGE_SIZE
from minitouch_bench.sensing.touch import FORCES, OPENINGS, POSITION, TOUCH_SIZE

POSITION_LIMIT_M = 2.0
"""No point of the arm can be further from its base (its reach is 0.855 m)."""

Observation = dict[str, NDArray[Any]]
"""``image``: uint8 (1, 84, 84), grey; ``touch``: float32 (11,), see ``sensing.touch``."""


def observation_space(force_limit: float) -> spaces.Dict:
    """Return the space of observations with forces within ``force_limit`` (N)."""
    low = np.empty(TOUCH_SIZE, np.float32)
    high = np.empty(TOUCH_SIZE, np.float32)
    low[POSITION], high[POSITION] = -POSITION_LIMIT_M, POSITION_LIMIT_M
    low[OPENINGS], high[OPENINGS] = 0.0, 1.0
    low[FORCES], high[FORCES] = -force_limit, force_limit
    return spaces.Dict(
        {
            "image": spaces.Box(0, 255, (1, IMAGE_SIZE, IMAGE_SIZE), np.uint8),
            "touch": spaces.Box(low, high, dtype=np.float32),
        }
    )
