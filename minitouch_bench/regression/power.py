"""How many episodes it takes to see a difference, and how small a one can be seen.

Both at a power of 80 %: four times in five, if the difference is the one observed.
"""

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy
from numpy.typing import NDArray

from minitouch_bench.metrics.intervals import NORMAL_QUANTILE
from minitouch_bench.metrics.significance import POWER, Discordance, last_true, score_statistic

POWER_QUANTILE = NormalDist().inv_cdf(POWER)

EXACT_UP_TO = 2000
"""Episodes up to which the power of a test of shares is summed exactly."""

MOST_EPISODES = 1_000_000
"""No larger number of episodes is ever asked for."""

NEGLIGIBLE = 1e-10
"""Probability of the counts that a sum leaves out at either end."""

FEWEST_FOR_A_MEAN = 10
"""Episodes below which no bound of a mean is believed."""


@dataclass(frozen=True)
class ShareResolution:
    """What the pairs that differ, of shares, tell of the episodes that a clear answer takes.

    Source: the exact unconditional power of McNemar's test and of Tango's score test; beyond
    EXACT_UP_TO episodes R. J. Connor, "Sample size for testing differences in proportions
    for the paired-sample design", Biometrics 43 (1987).
    """

    discordance: Discordance

    def episodes_to_detect(self, alpha: float, beyond: float = 0.0) -> int | None:
        """Return the episodes that show a difference above ``beyond`` by McNemar's test."""
        lost, won = self._rates()
        if abs(lost - won) <= beyond:
            return None
        guess = _connor(_two_sided(alpha), lost + won, abs(lost - won), beyond)
        return _least(lambda n: mcnemar_power(n, lost, won, alpha, beyond) >= POWER, guess)

    def episodes_to_exclude(self, margin: float) -> int | None:
        """Return the episodes whose score interval excludes a worsening of ``margin``, or None."""
        lost, won = self._rates()
        room = margin + won - lost
        if room <= 0.0:
            return None
        deviation = math.sqrt(lost + won - (lost - won) ** 2)
        guess = ((NORMAL_QUANTILE + POWER_QUANTILE) * deviation / room) ** 2
        return _least(lambda n: exclusion_power(n, lost, won, margin) >= POWER, guess)

    def detectable(self, alpha: float) -> float | None:
        """Return the smallest difference that as many episodes show, None for none.

        The share of pairs that differ stays as it is, or is larger where it must be.
        """
        differing = sum(self._rates())

        def is_seen(difference: float) -> bool:
            total = max(differing, difference)
            rates = ((total + difference) / 2.0, (total - difference) / 2.0)
            return mcnemar_power(self.discordance.n, *rates, alpha) >= POWER

        if self.discordance.n > EXACT_UP_TO:
            needed = _two_sided(alpha) + POWER_QUANTILE
            return needed * math.sqrt(max(differing, 1.0 / self.discordance.n) / self.discordance.n)
        if not is_seen(1.0):
            return None
        return last_true(lambda difference: not is_seen(difference), 0.0, 1.0, halvings=20)

    def _rates(self) -> tuple[float, float]:
        return self.discordance.lost / self.discordance.n, self.discordance.won / self.discordance.n


@dataclass(frozen=True)
class MeanResolution:
    """The same of means, by ``n`` paired differences: their mean as a worsening, their deviation.

    Source: W. C. Guenther, "Sample size formulas for normal theory t tests", Am. Stat. 35
    (1981).
    """

    n: int
    worsening: float
    deviation: float

    def episodes_to_detect(self, alpha: float, beyond: float = 0.0) -> int | None:
        """Return the episodes for a paired t test; signs alone need a few as well."""
        episodes = self._episodes(abs(self.worsening), _two_sided(alpha))
        larger = self._episodes(abs(self.worsening) - beyond, 0.0)
        if episodes is None or larger is None:
            return None
        return max(episodes, larger, math.ceil(math.log2(2.0 / alpha)))

    def episodes_to_exclude(self, margin: float) -> int | None:
        """Return the episodes whose 95 % interval excludes a worsening of ``margin``, or None."""
        episodes = self._episodes(margin - self.worsening, NORMAL_QUANTILE)
        return None if episodes is None else max(episodes, FEWEST_FOR_A_MEAN)

    def detectable(self, alpha: float) -> float | None:
        """Return the smallest difference that as many episodes show; None without any variation."""
        quantile = _two_sided(alpha)
        freedom = self.n - _overhead(quantile)
        if freedom <= 0.0 or self.deviation == 0.0:
            return None
        return (quantile + POWER_QUANTILE) * self.deviation / math.sqrt(freedom)

    def _episodes(self, distance: float, quantile: float) -> int | None:
        if distance <= 0.0:
            return None
        needed = ((quantile + POWER_QUANTILE) * self.deviation / distance) ** 2
        return _as_count(needed + _overhead(quantile))


Resolution = ShareResolution | MeanResolution


class NoResolution:
    """The same of a statistic whose power has no formula: no number of episodes is known."""

    def episodes_to_detect(self, alpha: float, beyond: float = 0.0) -> None:
        """Return None."""

    def episodes_to_exclude(self, margin: float) -> None:
        """Return None."""

    def detectable(self, alpha: float) -> None:
        """Return None."""


def mcnemar_power(n: int, lost: float, won: float, alpha: float, beyond: float = 0.0) -> float:
    """Return the chance that the exact McNemar test shows the larger of two rates as such.

    ``lost`` and ``won`` are the shares of pairs of which only one succeeds; the difference
    of the shares seen must be larger than ``beyond``.
    """
    differing = lost + won
    if differing == 0.0:
        return 0.0
    pairs = np.arange(n + 1)
    above = np.floor((pairs + beyond * n) / 2.0) + 1.0
    fewest = np.maximum(critical_counts(pairs, alpha), above)
    chances = scipy.stats.binom.sf(fewest - 1.0, pairs, max(lost, won) / differing)
    return float(scipy.stats.binom.pmf(pairs, n, min(1.0, differing)) @ chances)


def critical_counts(pairs: NDArray[np.int64], alpha: float) -> NDArray[np.float64]:
    """Return the least count of so many pairs with ``mcnemar_p`` <= alpha, or ``pairs`` + 1."""
    at = scipy.stats.binom.ppf(alpha / 2.0, pairs, 0.5)
    exact = 2.0 * scipy.stats.binom.cdf(at, pairs, 0.5) <= alpha
    counts: NDArray[np.float64] = pairs + 1 - at - exact
    return counts


def exclusion_power(n: int, lost: float, won: float, margin: float) -> float:
    """Return the chance that Tango's 95 % interval excludes a loss of ``margin``."""
    losses, gains = _likely_counts(n, lost)[:, None], _likely_counts(n, won)
    rest = min(1.0, won / (1.0 - lost)) if lost < 1.0 else 0.0
    chances = scipy.stats.binom.pmf(losses, n, lost) * scipy.stats.binom.pmf(
        gains, n - losses, rest
    )
    statistic = score_statistic(losses, gains, n, -margin)
    return float(chances[statistic > NORMAL_QUANTILE].sum())


def _likely_counts(n: int, share: float) -> NDArray[np.float64]:
    """Return the counts of n draws, but for NEGLIGIBLE ones at either end."""
    low, high = (
        scipy.stats.binom.ppf(NEGLIGIBLE, n, share),
        scipy.stats.binom.isf(NEGLIGIBLE, n, share),
    )
    return np.arange(max(low, 0.0), high + 1.0)


def _least(is_enough: Callable[[int], bool], guess: float) -> int | None:
    """Return nearly the least number of episodes that is enough; beyond EXACT_UP_TO the guess."""
    if guess > 1.2 * EXACT_UP_TO:
        return _as_count(guess)
    high = min(max(4, math.ceil(guess)), EXACT_UP_TO)
    while not is_enough(high):
        if high == EXACT_UP_TO:
            return _as_count(guess)
        high = min(math.ceil(1.3 * high), EXACT_UP_TO)
    return bisect_left(range(high), True, lo=1, key=is_enough)


def _connor(quantile: float, differing: float, difference: float, beyond: float) -> float:
    """Return the episodes for McNemar's test in its normal form."""
    spread = math.sqrt(max(differing - difference**2, 0.0))
    root = (quantile * math.sqrt(differing) + POWER_QUANTILE * spread) / difference
    larger = POWER_QUANTILE * spread / (difference - beyond)
    return max(root, larger) ** 2


def _overhead(quantile: float) -> float:
    """Return Guenther's episodes beyond those of the normal formula, for an estimated deviation."""
    return quantile**2 / 2.0


def _two_sided(alpha: float) -> float:
    return float(scipy.stats.norm.ppf(1.0 - alpha / 2.0))


def _as_count(episodes: float) -> int | None:
    return math.ceil(episodes) if episodes <= MOST_EPISODES else None
