"""The level and the power of every test, and the correction for several of them."""

from collections.abc import Sequence
from typing import Final

import numpy as np

ALPHA: Final = 0.05
"""A p-value up to this is significant."""

POWER: Final = 0.8
"""A difference is called detectable if so large a share of equal experiments would show it."""


def holm(p_values: Sequence[float]) -> tuple[float, ...]:
    """Return the p-values adjusted so that the chance of any false one stays at the level.

    Each keeps its index; an adjusted value is at least the one given and at most 1. scipy
    adjusts for false discoveries only.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J.
    Stat. 6 (1979).
    """
    order = np.argsort(p_values, kind="stable")
    scaled = np.asarray(p_values)[order] * np.arange(len(order), 0, -1)
    adjusted = np.empty(len(order))
    adjusted[order] = np.maximum.accumulate(np.minimum(scaled, 1.0))
    return tuple(adjusted.tolist())
