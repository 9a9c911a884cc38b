"""95 % intervals of shares, means and their differences, and the random streams they draw from."""

import hashlib
import math
from collections.abc import Sequence
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


def wilson(successes: int, n: int) -> Estimate:
    """Estimate a share; the interval has a width at 0 and at 100 % too.

    Errors: ValueError unless 0 <= successes <= n and n > 0.
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

    Errors: ValueError for no values.
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
