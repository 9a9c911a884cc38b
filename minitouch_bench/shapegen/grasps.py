"""Where to grip: the best place for two parallel pads, straight down, at a fixed hand yaw."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from minitouch_bench.shapegen.mesh import Points

PAD_HALF_WIDTH = 0.0105
"""Half the width of the Panda's finger along x, m."""
TIP_BELOW_TARGET = 0.0072
"""Fingertip below the grasp-target link, m."""
PAD_ABOVE_TARGET = 0.011
"""Upper edge of the flat pad above the grasp-target link, m."""
RECESS = 0.0025
"""How far the finger stands back above its pad, m, on each side."""
PALM_ABOVE_TARGET = 0.039
"""Underside of the hand above the grasp-target link, m."""
LOWEST_TARGET = 0.0112
"""Grasp-target height that keeps the fingertips 4 mm above the table, m."""
OPENING = 0.08
"""Distance between the open pads, m."""
DEEP = 0.012
"""How far above the fingertips a body should reach between the pads, m."""
TRIED_NEAR = 0.004
TRIED_COST = 0.02
"""What a place this near one that was tried before costs, m."""


@dataclass(frozen=True)
class Grasp:
    """A place for the grasp target: offset from the center of mass in x, y and height, m.

    ``width`` is what must pass between the open pads there, m, inf where nothing fits.
    """

    x: float
    y: float
    z: float
    width: float


def plan_grasp(points: Points) -> Grasp:
    """Choose the best grasp of a resting body by pads that close along y.

    ``points``: dense surface points (N, 3), m, x and y from the center of mass, z from the
    table. Prefers a narrow place near the center of mass with contacts opposite each other.
    Shapes are proven with it: another choice would make another set of the same seed.
    """
    middle = max((float(points[:, 2].min()) + float(points[:, 2].max())) / 2.0, LOWEST_TARGET)
    return _best(points, middle, LOWEST_TARGET, depth=-np.inf)


def plan_deep_grasp(points: Points, lowest_target: float, tried: Sequence[float]) -> Grasp:
    """Choose a grasp as ``plan_grasp`` does, deep between the pads and where none was tried.

    ``lowest_target``: the least height of the grasp target over the table, m; ``tried``: x of
    earlier grasps, m.
    """
    middle = (float(points[:, 2].min()) + float(points[:, 2].max())) / 2.0
    return _best(points, middle, lowest_target, depth=DEEP, tried=tried)


def _best(
    points: Points,
    middle: float,
    lowest_target: float,
    *,
    depth: float,
    tried: Sequence[float] = (),
) -> Grasp:
    """Return the best grasp about a middle height, above the lowest one and clear of the palm."""
    lowest = max(lowest_target, float(points[:, 2].max()) + 0.003 - PALM_ABOVE_TARGET)
    heights = sorted({max(lowest, middle + step) for step in (-0.008, 0.0, 0.008)})
    best, best_score = Grasp(0.0, 0.0, lowest, float("inf")), float("inf")
    for z in heights:
        for x in np.arange(-0.018, 0.0181, 0.003).tolist():
            grasp, score = _rated(points, x, z, depth)
            score += TRIED_COST * sum(abs(x - before) < TRIED_NEAR for before in tried)
            if score < best_score:
                best, best_score = grasp, score
    return best


def _rated(points: Points, x: float, z: float, depth: float) -> tuple[Grasp, float]:
    """Return the grasp at a strip and height, and its score in m: less is better."""
    strip = points[np.abs(points[:, 0] - x) <= PAD_HALF_WIDTH]
    strip = strip[strip[:, 2] >= z - TIP_BELOW_TARGET - 0.002]
    pad = strip[strip[:, 2] <= z + PAD_ABOVE_TARGET]
    if len(pad) < 2:
        return Grasp(x, 0.0, z, float("inf")), float("inf")
    low, high = float(pad[:, 1].min()), float(pad[:, 1].max())
    wide_low = min(low, float(strip[:, 1].min()) + RECESS)
    wide_high = max(high, float(strip[:, 1].max()) - RECESS)
    width = wide_high - wide_low
    if width > OPENING - 0.006:
        return Grasp(x, 0.0, z, float("inf")), float("inf")
    left, right = pad[pad[:, 1] <= low + 0.0015], pad[pad[:, 1] >= high - 0.0015]
    across = left.mean(axis=0) - right.mean(axis=0)
    ends = 0.5 * np.abs(left.mean(axis=0) + right.mean(axis=0))
    shallow = max(0.0, depth + z - TIP_BELOW_TARGET - float(pad[:, 2].max()))
    overhang = (low - wide_low) + (wide_high - high)
    score = 0.3 * width + abs(float(across[0])) + abs(float(across[2])) + 0.8 * float(ends[0])
    score += 3.0 * (overhang + shallow)
    return Grasp(x, (wide_low + wide_high) / 2.0, z, width), score
