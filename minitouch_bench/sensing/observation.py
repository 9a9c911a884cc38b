"""The observation and its space."""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.sensing.touch import FORCES, OPENINGS, POSITION

Observation = dict[str, NDArray[Any]]
"""``image``: uint8 (1, 84, 84), grey; ``touch``: float32 (11,), see ``sensing.touch``."""


def observation_space(force_limit: float) -> spaces.Dict:
    """Return the space of observations with forces within ``force_limit`` (N)."""
    spec = PROTOCOL.observation
    low = np.empty(spec.touch_size, np.float32)
    high = np.empty(spec.touch_size, np.float32)
    low[POSITION], high[POSITION] = -spec.position_limit, spec.position_limit
    low[OPENINGS], high[OPENINGS] = 0.0, 1.0
    low[FORCES], high[FORCES] = -force_limit, force_limit
    return spaces.Dict(
        {
            "image": spaces.Box(0, 255, (1, spec.image_size, spec.image_size), np.uint8),
            "touch": spaces.Box(low, high, dtype=np.float32),
        }
    )
