"""95 % intervals of shares, means and their differences, and the random streams they draw from.

The second half estimates many samples of one size at once: rows of a leaderboard face the same
episodes. One set of resamples serves them all, so a thousand rows cost little more than one, and
no row is luckier in its draws than another. ``scipy.stats.bootstrap`` draws for each sample.
"""

import hashlib
import math
from collections.abc import Sequence
from functools import cache
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from minitouch_bench.records import Estimate

WILSON = "wilson"
NEWCOMBE = "newcombe"
BOOTSTRAP = "bootstrap"

NORMAL_QUANTILE = 1.959963984540054
"""The 97.5 % point of the standard normal distribution."""

RESAMPLES = 10_000
DRAWS_PER_BLOCK = 2**20
"""Episodes drawn at a time, so that memory stays at some 16 MB however many there are."""

INTERVAL_ENDS = (0.025, 0.975)
"""The quantiles between which a 95 % interval lies."""

MANTISSA = 52
"""Bits after the first one of a float64."""

COLUMNS_PER_BLOCK = 64
"""Samples estimated at a time: some 5 MB of resampled means."""


@cache
def wilson(successes: int, n: int) -> Estimate:
    """Estimate a share; the interval has a width at 0 and at 100 % too.

    Raises:
        ValueError: unless 0 <= successes <= n and n > 0.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical
    inference", J. Am. Stat. Assoc. 22 (1927).
    """
    if not 0 <= successes <= n or n == 0:
        raise ValueError(f"{successes} successes of {n} episodes is no share")
    low, high = stats.binomtest(successes, n).proportion_ci(method="wilson")
    return Estimate(successes / n, float(low), float(high), n, WILSON)


def newcombe(first: Estimate, second: Estimate) -> Estimate:
    """Estimate the difference of two independent shares, first minus second.

    The hybrid score interval: each end joins the distances to the ends of the two Wilson
    intervals. It stays inside -1 to 1 and has a width at 0 and at 100 % too.

    Raises:
        ValueError: unless both estimates are of ``wilson``.

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

    Raises:
        ValueError: no values.

    Source: B. Efron, "Better bootstrap confidence intervals", J. Am. Stat. Assoc. 82 (1987).
    """
    sample = _as_sample(values)
    if _is_constant(sample):
        constant = float(sample[0])
        return Estimate(constant, constant, constant, sample.size, BOOTSTRAP)
    found = stats.bootstrap((sample,), np.mean, **_options(sample.size, rng, resamples))
    return _around(float(sample.mean()), found, sample.size)


def bootstrap_difference(
    first: Sequence[float] | NDArray[np.float64],
    second: Sequence[float] | NDArray[np.float64],
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
) -> Estimate:
    """Estimate the difference of two means, first minus second, over independent episodes.

    Each sample is resampled by itself. Where both have no variation the width is 0, as in
    ``bootstrap_mean``, whose correction it has.

    Raises:
        ValueError: no values.

    Source: B. Efron and R. J. Tibshirani, "An introduction to the bootstrap" (1993), ch. 8
    and 14.
    """
    one, other = _as_sample(first), _as_sample(second)
    count = one.size + other.size
    if _is_constant(one) and _is_constant(other):
        constant = float(one[0] - other[0])
        return Estimate(constant, constant, constant, count, BOOTSTRAP)
    found = stats.bootstrap((one, other), _mean_difference, **_options(count, rng, resamples))
    return _around(float(one.mean() - other.mean()), found, count)


def _as_sample(values: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values as float64 (N,)."""
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or sample.size == 0:
        raise ValueError("the bootstrap needs a one-dimensional, non-empty sample")
    return sample


def _is_constant(sample: NDArray[np.float64]) -> bool:
    """Tell whether all values are equal; rounding would give their mean a width of 1e-17."""
    return bool(np.all(sample == sample[0]))


def _mean_difference(
    first: NDArray[np.float64], second: NDArray[np.float64], axis: int
) -> NDArray[np.float64]:
    difference: NDArray[np.float64] = first.mean(axis) - second.mean(axis)
    return difference


def _options(size: int, rng: np.random.Generator, resamples: int) -> dict[str, Any]:
    """Return how to resample ``size`` episodes."""
    batch = max(1, DRAWS_PER_BLOCK // size)
    return {"n_resamples": resamples, "batch": batch, "method": "BCa", "rng": rng}


def _around(value: float, found: Any, count: int) -> Estimate:
    """Return an estimate whose interval holds its value, which few episodes do not ensure."""
    low, high = map(float, found.confidence_interval)
    return Estimate(value, min(low, value), max(high, value), count, BOOTSTRAP)


Root = tuple[int, ...]
"""The words of a root seed."""


def stream(root: Root, *names: str) -> np.random.Generator:
    """Return the random stream of a name, such as a task and a metric, under a root seed."""
    digest = hashlib.sha256("/".join(names).encode()).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return np.random.default_rng(np.random.SeedSequence([*root, *words]))


# Many samples of one size at once


@cache
def resample_weights(size: int, root: Root, name: str) -> NDArray[np.float64]:
    """Return how often each of ``size`` values is drawn in each resample, as (RESAMPLES, size).

    Source: B. Efron, "Bootstrap methods: another look at the jackknife", Ann. Stat. 7 (1979);
    the counts of a draw with replacement are multinomial.
    """
    rng = stream(root, name, str(size))
    counts = rng.multinomial(size, np.full(size, 1 / size), size=RESAMPLES)
    return counts.astype(np.float64)


def mean_intervals(
    values: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the 95 % interval of each sample's mean, (N, 2), of values (N, size).

    Corrected for bias and acceleration (BCa), as in ``bootstrap_mean``.

    The mean is over the values that are not NaN, which a resample may draw more or less often;
    NaN where there is none. Equal values give a width of 0.
    """
    found = np.empty((len(values), 2))
    for start in range(0, len(values), COLUMNS_PER_BLOCK):
        block = slice(start, start + COLUMNS_PER_BLOCK)
        found[block] = _block(values[block], weights)
    return found


def stratified_intervals(
    strata: list[NDArray[np.float64]], weights: list[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return the 95 % percentile interval of the mean over strata of their means, (N, 2).

    ``strata``: values (N, size) each; every stratum is resampled by itself, with ``weights``.

    Source: R. Agarwal et al., "Deep reinforcement learning at the edge of the statistical
    precipice", NeurIPS 2021: training runs resampled task by task.
    """
    found = np.empty((len(strata[0]), 2))
    for start in range(0, len(found), COLUMNS_PER_BLOCK):
        block = slice(start, start + COLUMNS_PER_BLOCK)
        means = np.mean([_means(v[block], w) for v, w in zip(strata, weights, strict=True)], axis=0)
        found[block] = _at(np.sort(means, axis=1), np.tile(INTERVAL_ENDS, (len(means), 1)))
    return found


def _block(values: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    known = ~np.isnan(values)
    filled = np.where(known, values, 0.0)
    partly = ~known.all(axis=1)
    with np.errstate(invalid="ignore"):  # a resample, or a sample, without a value
        estimates = filled.sum(axis=1) / known.sum(axis=1)
        sums = _on_grid(filled) @ weights.T
        means = sums / values.shape[1]
        means[partly] = sums[partly] / (known[partly] @ weights.T)
    influences = np.where(known, values - estimates[:, None], 0.0)
    limits = _corrected_limits(means, estimates, influences)
    for row, (own, used) in enumerate(zip(values, known, strict=True)):
        if used.any() and np.ptp(own[used]) == 0:  # rounding would give it a width of 1e-17
            limits[row] = own[used][0]
        elif not used.any():
            limits[row] = np.nan
    return limits


def _corrected_limits(
    means: NDArray[np.float64], estimates: NDArray[np.float64], influences: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the BCa ends of each row of resampled means, (N, 2)."""
    ordered = np.sort(means, axis=1)  # NaN last
    levels = np.full((len(ordered), 2), np.nan)
    for row, (own, estimate, influence) in enumerate(
        zip(ordered, estimates, influences, strict=True)
    ):
        resamples = int(np.searchsorted(own, np.nan))
        if resamples > 1 and influence.any():
            ends = (np.searchsorted(own, estimate, side) for side in ("left", "right"))
            levels[row] = _corrected_levels(sum(map(int, ends)) / 2, resamples, influence)
    limits = _at(ordered, levels)
    return np.stack([np.minimum(limits[:, 0], estimates), np.maximum(limits[:, 1], estimates)], 1)


def _corrected_levels(
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


def _at(ordered: NDArray[np.float64], levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quantiles at ``levels`` (N, 2) of sorted rows, without their NaN.

    Linear between two values, as numpy's; one sort of a row takes a fifth of its time.
    """
    last = np.maximum(np.count_nonzero(~np.isnan(ordered), axis=1) - 1, 0)[:, None]
    place = last * np.nan_to_num(levels)
    below = np.floor(place).astype(int)
    low = np.take_along_axis(ordered, below, 1)
    high = np.take_along_axis(ordered, np.minimum(below + 1, last), 1)
    limits: NDArray[np.float64] = low + (high - low) * (place - below)
    return limits


def _means(values: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the resampled means, (N, RESAMPLES)."""
    means: NDArray[np.float64] = _on_grid(values) @ weights.T / values.shape[1]
    return means


def _on_grid(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round each row (N, size) to a power of two so fine that all of its sums are exact.

    A matrix product adds in an order that depends on the number of rows and of threads and on
    the processor. Exact sums do not: a row gets the same bits alone and among a thousand.
    """
    largest = values.shape[1] * np.abs(values).max(axis=1, initial=0.0, keepdims=True)
    step = np.exp2(np.ceil(np.log2(np.maximum(largest, np.finfo(float).tiny))) - MANTISSA)
    rounded: NDArray[np.float64] = np.rint(values / step) * step
    return rounded
