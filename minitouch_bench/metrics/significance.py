"""Every test: their level and power, paired shares, flips of signs, correction for several."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from minitouch_bench.metrics.intervals import DRAWS_PER_BLOCK, NORMAL_QUANTILE, RESAMPLES, Estimate

ALPHA: Final = 0.05
"""A p-value up to this is significant."""

POWER: Final = 0.8
"""A difference is called detectable if so large a share of equal experiments would show it."""

TANGO = "tango"

HALVINGS = 60
"""Of an interval of length 2, to the last bit of a float."""

EXACT_FLIPS = 13
"""Up to so many differences that are not 0, every choice of signs is tried."""


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
    def mirrored(self) -> "Discordance":
        """The same with the runs in the other order."""
        return Discordance(self.n, self.won, self.lost)

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
    tails: NDArray[np.float64] = scipy.stats.binom.cdf(
        np.minimum(lost, won), np.add(lost, won), 0.5
    )
    return np.minimum(1.0, 2.0 * tails)


def tango(discordance: Discordance, quantile: float = NORMAL_QUANTILE) -> Estimate:
    """Estimate the difference of two paired shares, second minus first.

    The score interval: every difference that the score test does not reject. It stays inside
    -1 to 1 and has a width at 0 and at 100 % too, and where no pair differs. scipy has none
    for paired shares.

    Source: T. Tango, "Equivalence test and confidence interval for the difference in
    proportions for the paired-sample design", Stat. Med. 17 (1998).
    """
    low, high = _lower_end(discordance, quantile), -_lower_end(discordance.mirrored, quantile)
    return Estimate(discordance.difference, low, high, discordance.n, TANGO)


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


def _lower_end(discordance: Discordance, quantile: float) -> float:
    if discordance.difference == -1.0:
        return -1.0
    lost, won = np.array([discordance.lost], float), np.array([discordance.won], float)

    def is_rejected(difference: float) -> bool:
        return bool(score_statistic(lost, won, discordance.n, difference)[0] > quantile)

    return last_true(is_rejected, -1.0, discordance.difference)


def last_true(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Return the point between two up to which a condition is true, ``low`` if it is nowhere."""
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def sign_flip_p(
    differences: NDArray[np.float64], rng: np.random.Generator, resamples: int = RESAMPLES
) -> float:
    """Return the two-sided p-value of the sign-flip test of a mean of 0.

    It is exact however few the episodes where the policies are equal, and so the sign of each
    difference is a coin's. Every choice of signs is tried for few differences, ``resamples`` drawn
    ones for many. ``scipy.stats.permutation_test`` gives the same and takes 90 times as long for
    100.

    Source: R. A. Fisher, "The design of experiments" (1935), ch. 21.
    """
    sizes = np.abs(differences[differences != 0.0])
    observed = abs(float(differences.sum())) * (1.0 - 1e-12)  # sums of one set differ in rounding
    if len(sizes) <= EXACT_FLIPS:
        choices = np.arange(2 ** len(sizes))[:, None] >> np.arange(len(sizes)) & 1
        return float(np.mean(np.abs((2.0 * choices - 1.0) @ sizes) >= observed))
    as_large = 0
    for count in _blocks(resamples, len(sizes)):
        octets = rng.integers(256, size=(count, -(-len(sizes) // 8)), dtype=np.uint8)
        positive = np.unpackbits(octets, axis=1, count=len(sizes)).astype(np.float64)
        sums = 2.0 * (positive @ sizes) - sizes.sum()
        as_large += int(np.count_nonzero(np.abs(sums) >= observed))
    return (1 + as_large) / (1 + resamples)


def _blocks(resamples: int, size: int) -> list[int]:
    """Return how many resamples to draw at a time, so that memory stays small."""
    block = max(1, DRAWS_PER_BLOCK // size)
    whole, rest = divmod(resamples, block)
    return [block] * whole + [rest] * (rest > 0)


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
