"""95 % intervals of a share and of a mean, and of the difference between two of them."""

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.records import Estimate

WILSON = "wilson"
NEWCOMBE = "newcombe"
BOOTSTRAP = "bootstrap"

NORMAL_QUANTILE = 1.959963984540054
"""The 97.5 % point of the standard normal distribution."""

RESAMPLES = 10_000
DRAWS_PER_BLOCK = 2**20
"""Episodes drawn at a time, so that memory stays at some 16 MB however many there are."""


def wilson(successes: int, n: int) -> Estimate:
    """Estimate a share; the interval has a width at 0 and at 100 % too.

    Errors: ValueError unless 0 <= successes <= n and n > 0.
    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical
    inference", J. Am. Stat. Assoc. 22 (1927).
    """
    if not 0 <= successes <= n or n == 0:
        raise ValueError(f"{successes} successes of {n} episodes is no share")
    share, z2 = successes / n, NORMAL_QUANTILE**2
    centre = (share + z2 / (2 * n)) / (1 + z2 / n)
    spread = NORMAL_QUANTILE * math.sqrt(share * (1 - share) / n + z2 / (4 * n * n)) / (1 + z2 / n)
    # At the ends the formula meets 0 and 1 exactly; rounding would miss them by 1e-17.
    low = 0.0 if successes == 0 else centre - spread
    high = 1.0 if successes == n else centre + spread
    return Estimate(share, low, high, n, WILSON)


def newcombe(first: Estimate, second: Estimate) -> Estimate:
    """Estimate the difference of two independent shares, first minus second.

    The hybrid score interval: each end joins the distances to the ends of the two Wilson
    intervals. It stays inside -1 to 1 and has a width at 0 and at 100 % too.

    Errors: ValueError unless both estimates are of ``wilson``.
    Source: R. G. Newcombe, "Interval estimation for the difference between independent
    proportions: comparison of eleven methods", Stat. Med. 17 (1998), method 10.
    """
    if not first.method == second.method == WILSON:
        raise ValueError("the score interval of a difference needs two shares")
    value = first.value - second.value
    below = math.hypot(first.value - first.low, second.high - second.value)
    above = math.hypot(first.high - first.value, second.value - second.low)
    return Estimate(value, value - below, value + above, first.count + second.count, NEWCOMBE)


def bootstrap_mean(
    values: Sequence[float] | NDArray[np.float64],
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
) -> Estimate:
    """Estimate a mean with the bootstrap over episodes.

    The percentiles of the resampled means are corrected for bias and acceleration (BCa), so
    that the interval follows a skewed sample: a few long episodes among short ones. Its ends
    stay inside the range of the values (a count of steps is never below 0). It is a little
    narrow for few episodes, and equal values give an interval of width 0: it then says only
    that no variation was seen.

    Errors: ValueError for no values.
    Source: B. Efron, "Better bootstrap confidence intervals", J. Am. Stat. Assoc. 82 (1987).
    """
    sample = _as_sample(values)
    if _is_constant(sample):
        constant = float(sample[0])
        return Estimate(constant, constant, constant, sample.size, BOOTSTRAP)
    mean = float(sample.mean())
    low, high = _corrected_ends(_resampled_means(sample, rng, resamples), mean, sample - mean)
    return Estimate(mean, low, high, sample.size, BOOTSTRAP)


def bootstrap_difference(
    first: Sequence[float] | NDArray[np.float64],
    second: Sequence[float] | NDArray[np.float64],
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
) -> Estimate:
    """Estimate the difference of two means, first minus second, over independent episodes.

    Each sample is resampled by itself. Where both have no variation the width is 0, as in
    ``bootstrap_mean``, whose correction it has.

    Errors: ValueError for no values.
    Source: B. Efron and R. J. Tibshirani, "An introduction to the bootstrap" (1993), ch. 8
    and 14.
    """
    one, other = _as_sample(first), _as_sample(second)
    count = one.size + other.size
    if _is_constant(one) and _is_constant(other):
        constant = float(one[0] - other[0])
        return Estimate(constant, constant, constant, count, BOOTSTRAP)
    means = _resampled_means(one, rng, resamples)
    differences = means - _resampled_means(other, rng, resamples)
    value = float(one.mean() - other.mean())
    influences = ((one - one.mean()) / one.size, (other.mean() - other) / other.size)
    low, high = _corrected_ends(differences, value, np.concatenate(influences))
    return Estimate(value, low, high, count, BOOTSTRAP)


def _as_sample(values: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values as float64 (N,)."""
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or sample.size == 0:
        raise ValueError("the bootstrap needs a one-dimensional, non-empty sample")
    return sample


def _is_constant(sample: NDArray[np.float64]) -> bool:
    """Tell whether all values are equal; rounding would give their mean a width of 1e-17."""
    return bool(np.all(sample == sample[0]))


def _resampled_means(
    sample: NDArray[np.float64], rng: np.random.Generator, resamples: int
) -> NDArray[np.float64]:
    """Return the means of ``resamples`` samples drawn with replacement, as (resamples,)."""
    means = np.empty(resamples)
    block = max(1, DRAWS_PER_BLOCK // sample.size)
    for start in range(0, resamples, block):
        stop = min(start + block, resamples)
        drawn = rng.integers(sample.size, size=(stop - start, sample.size))
        means[start:stop] = sample[drawn].mean(axis=1)
    return means


def _corrected_ends(
    resampled: NDArray[np.float64], value: float, influences: NDArray[np.float64]
) -> tuple[float, float]:
    """Return the BCa ends of resampled values, float64 (resamples,), around an estimate.

    ``influences`` are proportional to each episode's influence on the estimate.
    """
    below = np.count_nonzero(resampled < value) + np.count_nonzero(resampled == value) / 2.0
    levels = corrected_levels(float(below), resampled.size, influences)
    low, high = np.quantile(resampled, levels)
    return min(float(low), value), max(float(high), value)


def corrected_levels(
    below: float, resamples: int, influences: NDArray[np.float64]
) -> tuple[float, float]:
    """Return the shares of the resampled values below each BCa end of a 95 % interval.

    ``below``: how many of them are below the estimate, which tells the bias; the skew of
    ``influences`` (any multiple of each episode's influence) is the acceleration.
    """
    normal = NormalDist()
    share = min(max(below, 1.0), resamples - 1.0) / resamples
    bias = normal.inv_cdf(share)
    skew = float((influences**3).sum()) / float((influences**2).sum()) ** 1.5
    low, high = (
        normal.cdf(bias + end / (1.0 - skew / 6.0 * end))
        for end in (bias - NORMAL_QUANTILE, bias + NORMAL_QUANTILE)
    )
    # Rounded, so that the last bit of a C library's erf changes no report.
    return round(low, 9), round(high, 9)
