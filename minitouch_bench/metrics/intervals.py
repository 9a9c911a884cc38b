"""95 % intervals over episodes and over training seeds, and the random streams they draw from.

Every interval in a report, on the leaderboard and in ``experiments/`` comes from these functions,
or is computed from what they give. Those over the episodes of one run are computed once and stored
in its ``run.json``.
"""

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from minitouch_bench.episode import Count

Floats = NDArray[np.float64]
Values = Sequence[float] | Floats

WILSON = "wilson"
NEWCOMBE = "newcombe"
BOOTSTRAP = "bootstrap"
OVER_TASKS = "intervals of the tasks, added in quadrature"
OVER_SEEDS = "Student's t over training seeds, no narrower than over all their episodes"

NORMAL_QUANTILE = 1.959963984540054
"""The 97.5 % point of the standard normal distribution."""

RESAMPLES = 10_000
DRAWS_PER_BLOCK = 2**20
"""Episodes drawn at a time, so that memory stays at some 16 MB however many there are."""

INTERVAL_ENDS = (0.025, 0.975)
"""The quantiles between which a 95 % interval lies."""


@dataclass(frozen=True)
class Estimate:
    """A value and its 95 % interval; ``method`` says how, and what there are ``count`` of."""

    value: float
    low: float
    high: float
    count: Count
    method: str

    def __str__(self) -> str:
        return f"{self}"

    def __format__(self, form: str) -> str:
        form = form or ".4g"
        return f"{self.value:{form}} [{self.low:{form}}, {self.high:{form}}]"


@cache
def wilson(successes: int, n: int) -> Estimate:
    """Estimate a share; the interval has a width at 0 and at 100 % too.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical
    inference", J. Am. Stat. Assoc. 22 (1927).
    """
    low, high = scipy.stats.binomtest(successes, n).proportion_ci(method="wilson")
    return Estimate(successes / n, float(low), float(high), n, WILSON)


def newcombe(first: Estimate, second: Estimate) -> Estimate:
    """Estimate the difference of two independent shares, of ``wilson``, first minus second.

    The hybrid score interval: each end joins the distances to the ends of the two Wilson
    intervals. It stays inside -1 to 1 and has a width at 0 and at 100 % too.

    Source: R. G. Newcombe, "Interval estimation for the difference between independent
    proportions: comparison of eleven methods", Stat. Med. 17 (1998), method 10.
    """
    value = first.value - second.value
    below = math.hypot(first.value - first.low, second.high - second.value)
    above = math.hypot(first.high - first.value, second.value - second.low)
    return Estimate(value, value - below, value + above, first.count + second.count, NEWCOMBE)


def mean_difference(first: Floats, second: Floats, axis: int) -> Floats:
    """Return the difference of the means along an axis, first minus second."""
    difference: Floats = first.mean(axis) - second.mean(axis)
    return difference


def bootstrap(
    samples: Sequence[Values], rng: np.random.Generator, resamples: int = RESAMPLES
) -> Estimate:
    """Estimate the mean of one sample of episodes, or the difference of the means of two.

    The percentiles of the resampled means are corrected for bias and acceleration (BCa), so
    that the interval follows a skewed sample: a few long episodes among short ones. The ends of a
    mean's interval stay inside the range of the values (a count of steps is never below 0). It is a
    little narrow for few episodes, and equal values give an interval of width 0: it then says only
    that no variation was seen.

    A difference is the first minus the second, over independent episodes: each sample is resampled
    by itself.

    Raises:
        ValueError: a sample has no values.

    Source: B. Efron, "Better bootstrap confidence intervals", J. Am. Stat. Assoc. 82 (1987);
    B. Efron and R. J. Tibshirani, "An introduction to the bootstrap" (1993), ch. 8 and 14.
    """
    statistic: Callable[..., Any] = np.mean if len(samples) == 1 else mean_difference
    arrays = [np.asarray(sample, dtype=np.float64) for sample in samples]
    count = sum(array.size for array in arrays)
    if all(np.ptp(array) == 0.0 for array in arrays):
        # Rounding would give the mean of equal values a width of 1e-17.
        constant = float(statistic(*(array[:1] for array in arrays), axis=0))
        return Estimate(constant, constant, constant, count, BOOTSTRAP)
    interval = scipy.stats.bootstrap(
        arrays, statistic, n_resamples=resamples, batch=max(1, DRAWS_PER_BLOCK // count), rng=rng
    ).confidence_interval
    value = float(statistic(*arrays, axis=0))
    return Estimate(
        value,
        float(np.fmin(interval.low, value)),  # an end that is NaN becomes the value
        float(np.fmax(interval.high, value)),
        count,
        BOOTSTRAP,
    )


Root = tuple[int, ...]
"""The words of a root seed."""


def stream(root: Root, *names: str) -> np.random.Generator:
    """Return the random stream of a name, such as a task and a metric, under a root seed."""
    digest = hashlib.sha256("/".join(names).encode()).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return np.random.default_rng(np.random.SeedSequence([*root, *words]))


Bounds = tuple[float, float]
"""The least and the greatest value that a figure can have."""


def student_mean(values: Sequence[float], possible: Bounds) -> Estimate:
    """Estimate a mean of two or more values with Student's interval, cut at the ``possible`` ends.

    Source: Student, "The probable error of a mean", Biometrika 6 (1908).
    """
    number = len(values)
    mean = math.fsum(values) / number
    variance = math.fsum((value - mean) ** 2 for value in values) / (number - 1)
    quantile = float(scipy.stats.t.ppf(INTERVAL_ENDS[1], number - 1))
    reach = quantile * math.sqrt(variance / number)
    low, high = max(mean - reach, possible[0]), min(mean + reach, possible[1])
    return _rounded(Estimate(mean, low, high, number, OVER_SEEDS))


def over_seeds(estimates: Sequence[Estimate], possible: Bounds) -> Estimate:
    """Estimate a figure over training seeds from the estimate that each seed's run has of it.

    One seed's estimate is returned unchanged. Several seeds give their ``student_mean``. Where the
    seeds agree by chance its interval is narrower than their episodes allow, so it is widened to
    the interval over all episodes: ``pooled_share`` of shares, otherwise ``quadrature``. It holds
    its level where the seeds' values are about normal; where some seeds fail, no interval over a
    few seeds does.

    Raises:
        ValueError: there is no estimate.
    """
    if len(estimates) == 1:
        return estimates[0]
    mean = student_mean([estimate.value for estimate in estimates], possible)
    are_shares = all(estimate.method == WILSON for estimate in estimates)
    over_episodes = (pooled_share if are_shares else quadrature)(estimates)
    low, high = min(mean.low, over_episodes.low), max(mean.high, over_episodes.high)
    return _rounded(replace(mean, low=max(low, possible[0]), high=min(high, possible[1])))


DIGITS = 12
"""Decimals of an estimate over seeds or tasks: the last bits depend on versions of libraries."""


def pooled_share(shares: Sequence[Estimate]) -> Estimate:
    """Estimate a share over the episodes of several ``wilson`` estimates together."""
    successes = math.fsum(share.value * share.count for share in shares)
    return wilson(round(successes), sum(share.count for share in shares))


def quadrature(parts: Sequence[Estimate]) -> Estimate:
    """Estimate the mean of independent figures from their intervals, which may be those of shares.

    Source: G. Y. Zou and A. Donner, "Construction of confidence limits about effect measures:
    a general approach", Stat. Med. 27 (2008).
    """
    number = len(parts)
    value = math.fsum(part.value for part in parts) / number
    below = math.hypot(*(part.value - part.low for part in parts)) / number
    above = math.hypot(*(part.high - part.value for part in parts)) / number
    count = sum(part.count for part in parts)
    return _rounded(Estimate(value, value - below, value + above, count, OVER_TASKS))


def _rounded(estimate: Estimate) -> Estimate:
    value, low, high = (round(x, DIGITS) for x in (estimate.value, estimate.low, estimate.high))
    return replace(estimate, value=value, low=low, high=high)


@dataclass(frozen=True)
class MeanDifferences:
    """The differences of the means of all pairs of rows, first minus second, (N, N) each.

    ``variance`` is that of a difference, with its degrees of ``freedom``; ``over_episodes`` is the
    part of it that more training seeds do not make smaller.
    """

    value: Floats
    variance: Floats
    over_episodes: Floats
    freedom: Floats

    @property
    def p_values(self) -> Floats:
        """The two-sided p-values of no difference, 1 on the diagonal."""
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(self.value == 0, 0.0, self.value / np.sqrt(self.variance))
        p_values: Floats = 2.0 * scipy.special.stdtr(self.freedom, -np.abs(t))
        return p_values


def mean_differences(strata: Sequence[Sequence[Floats]]) -> MeanDifferences:
    """Compare all pairs of means over strata (tasks).

    ``strata`` holds the rows' samples of each task, float64 (S, E) each: training seeds by
    episodes. The variance of a difference has two parts: that of the paired differences over
    episodes, and, of each row of several training seeds, that of its seeds' means. Both contain
    the variation of single episodes, which is subtracted once, as in the analysis of several
    readers who judge the same cases. Student's t with the degrees of freedom of Satterthwaite, of
    the parts before the subtraction. The trainings of one task are independent of those of another.

    Where a row has one training seed, its checkpoint is compared, not its method.

    Source: N. A. Obuchowski and H. E. Rockette, "Hypothesis testing of diagnostic accuracy for
    multiple readers and multiple tests", Commun. Stat. Simul. 24 (1995); S. L. Hillis, "A
    comparison of denominator degrees of freedom methods for multiple observer ROC analysis",
    Stat. Med. 26 (2007).
    """
    number, tasks = len(strata[0]), len(strata)
    difference, variance, shared, spread = (np.zeros((number, number)) for _ in range(4))
    largest = 0.0
    for samples in strata:
        table = np.array([values.mean(axis=0) for values in samples])
        means = table.mean(axis=1)
        largest = max(largest, np.abs(means).max())
        difference += (means[:, None] - means[None, :]) / tasks
        seeds = [_seed_variances(values) for values in samples]
        total, within, freedom = np.array(seeds, np.float64).T
        own = np.maximum(total - within, 0.0)
        paired = _paired_variances(table)
        of_seeds = within[:, None] + within[None, :]
        shared += np.maximum(paired - of_seeds, 0.0) / tasks**2
        variance += (paired + own[:, None] + own[None, :]) / tasks**2
        parts = total**2 / freedom
        over_episodes = paired**2 / (table.shape[1] - 1)
        spread += (over_episodes + parts[:, None] + parts[None, :]) / tasks**4
    difference[np.abs(difference) < 1e-12 * largest] = 0.0  # rounding of equal rows
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(variance > 0, variance**2 / spread, 1.0)
    return MeanDifferences(difference, variance, shared, freedom)


def _paired_variances(table: Floats) -> Floats:
    """Return the variances of the mean differences over episodes, of row means (N, E), (N, N)."""
    covariance = np.atleast_2d(np.cov(table)) / table.shape[1]
    single = np.diag(covariance)
    both = single[:, None] + single[None, :]
    paired = np.maximum(both - 2 * covariance, 0.0)
    return np.where(paired < 1e-12 * both, 0.0, paired)  # rounding of equal rows


def _seed_variances(values: Floats) -> tuple[float, float, int]:
    """Return the variance of a row's mean over training seeds, float64 (S, E), with its freedom.

    Between them: its part that is the variation of single episodes. One seed tells nothing: 0.
    """
    seeds, episodes = values.shape
    if seeds == 1:
        return 0.0, 0.0, 1
    means = values.mean(axis=1)
    total = float(means.var(ddof=1)) / seeds
    residuals = values - values.mean(axis=0) - means[:, None] + values.mean()
    within = float((residuals**2).sum()) / (seeds - 1) / (episodes - 1) / (seeds * episodes)
    return total, within, seeds - 1
