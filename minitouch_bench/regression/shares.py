"""The difference of two success shares over the same episodes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from minitouch_bench.metrics.intervals import NORMAL_QUANTILE
from minitouch_bench.records import Estimate

TANGO = "tango"

HALVINGS = 60
"""Of an interval of length 2, to the last bit of a float."""


@dataclass(frozen=True)
class Discordance:
    """Of ``n`` paired episodes, those that only the first, only the second run succeeds in."""

    n: int
    lost: int
    won: int

    @property
    def difference(self) -> float:
        """Share of the second minus share of the first."""
        return (self.won - self.lost) / self.n

    @property
    def p_value(self) -> float:
        """The exact McNemar test's, two-sided."""
        return float(mcnemar_p(self.lost, self.won))


def count_discordance(first: NDArray[np.float64], second: NDArray[np.float64]) -> Discordance:
    """Count the pairs that differ; the values are 1 for success and 0, float64 (N,) each."""
    return Discordance(
        n=len(first),
        lost=int(np.count_nonzero(first > second)),
        won=int(np.count_nonzero(second > first)),
    )


def mcnemar_p(lost: ArrayLike, won: ArrayLike) -> NDArray[np.float64]:
    """Return the two-sided p-value of the exact McNemar test, elementwise.

    ``lost`` and ``won`` count the pairs of which only the first, only the second succeeds.
    Given their number, each is as likely as the other where the policies are equally good.
    Without such a pair the value is 1. ``scipy.stats.binomtest`` gives the same, one by one.

    Source: Q. McNemar, "Note on the sampling error of the difference between correlated
    proportions or percentages", Psychometrika 12 (1947), with exact binomial tails.
    """
    tails: NDArray[np.float64] = stats.binom.cdf(np.minimum(lost, won), np.add(lost, won), 0.5)
    return np.minimum(1.0, 2.0 * tails)


def tango(found: Discordance, quantile: float = NORMAL_QUANTILE) -> Estimate:
    """Estimate the difference of two paired shares, second minus first.

    The score interval: every difference that the score test does not reject. It stays inside
    -1 to 1 and has a width at 0 and at 100 % too, and where no pair differs. scipy has none
    for paired shares.

    Source: T. Tango, "Equivalence test and confidence interval for the difference in
    proportions for the paired-sample design", Stat. Med. 17 (1998).
    """
    low, high = _lower_end(found, quantile), _upper_end(found, quantile)
    return Estimate(found.difference, low, high, found.n, TANGO)


def score_statistic(
    lost: NDArray[np.float64], won: NDArray[np.float64], n: int, difference: float
) -> NDArray[np.float64]:
    """Return Tango's score statistic for a supposed difference in (-1, 1).

    ``lost`` and ``won`` are counts that broadcast together. It is standard normal
    where the supposition holds, and falls as the supposed difference grows. A variance of 0
    gives 0 or plus or minus infinity.
    """
    b = -won - lost + (2 * n - won + lost) * difference
    c = -lost * difference * (1.0 - difference)
    share = (np.sqrt(np.maximum(b * b - 8.0 * n * c, 0.0)) - b) / (4.0 * n)
    variance = np.maximum(n * (2.0 * share + difference * (1.0 - difference)), 0.0)
    distance = won - lost - n * difference
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic: NDArray[np.float64] = np.where(
            distance == 0.0, 0.0, distance / np.sqrt(variance)
        )
    return statistic


def _statistic(found: Discordance, difference: float) -> float:
    counts = np.array([found.lost], float), np.array([found.won], float)
    return float(score_statistic(*counts, found.n, difference)[0])


def _lower_end(found: Discordance, quantile: float) -> float:
    if found.difference == -1.0:
        return -1.0
    return last_true(lambda at: _statistic(found, at) > quantile, -1.0, found.difference)


def _upper_end(found: Discordance, quantile: float) -> float:
    mirrored = Discordance(found.n, lost=found.won, won=found.lost)
    return -_lower_end(mirrored, quantile)


def last_true(
    holds: Callable[[float], bool], low: float, high: float, halvings: int = HALVINGS
) -> float:
    """Return the point between two up to which something holds, ``low`` if nowhere above it."""
    for _ in range(halvings):
        middle = (low + high) / 2.0
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
