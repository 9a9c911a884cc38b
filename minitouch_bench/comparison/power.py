"""How many episodes settle whether two policies differ."""

import math
from bisect import bisect_left
from statistics import NormalDist

import numpy as np
import scipy
from numpy.typing import NDArray

from minitouch_bench.comparison.pairing import WORSE_SIGNS, PairedValues
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.intervals import NORMAL_QUANTILE
from minitouch_bench.metrics.statistics import (
    POWER,
    Discordance,
    Mean,
    Quantile,
    Share,
    count_discordance,
    mcnemar_p,
    score_statistic,
)

POWER_QUANTILE = NormalDist().inv_cdf(POWER)

EXACT_UP_TO = 2000
"""Episodes up to which the power of a test of shares is summed exactly."""

MOST_EPISODES = 1_000_000
"""No larger number of episodes is ever asked for."""

NEGLIGIBLE = 1e-8
"""Probability of the counts that a sum leaves out at either end."""

FEWEST_FOR_A_MEAN = 10
"""Episodes below which no bound of a mean is believed."""


def episodes_needed(
    values: PairedValues, level: float, tolerance: float | None = None
) -> int | None:
    """Return the episodes that settle a difference in four of five cases, if it is as observed.

    Args:
        values: The paired values of the episodes that there are.
        level: Two-sided level of the test of a difference.
        tolerance: A worsening by more is to be shown, one by less to be excluded by the 95 %
            interval, in the metric's unit. None: any difference is to be shown.

    Returns:
        None for no difference, too many episodes, or a quantile, whose power has no formula.

    Raises:
        TypeError: nothing is known of the metric's statistic.
    """
    worse = values.differences * WORSE_SIGNS.get(values.direction, 1.0)
    if tolerance is None:
        worse, tolerance = worse * np.sign(worse.mean()), 0.0
    match METRICS[values.metric].statistic:
        case Share():
            counts = count_discordance(np.maximum(worse, 0.0), np.maximum(-worse, 0.0))
            needed = _for_shares(counts, level, tolerance)
        case Mean():
            deviation = float(worse.std(ddof=1)) if len(worse) > 1 else 0.0
            needed = _for_means(float(worse.mean()), deviation, level, tolerance)
        case Quantile():
            return None
        case other:
            raise TypeError(f"how many episodes a difference of {other} takes is not defined")
    return math.ceil(needed) if needed <= MOST_EPISODES else None


def _for_shares(counts: Discordance, level: float, tolerance: float) -> float:
    """Return the episodes for the exact McNemar test, or for Tango's interval.

    Beyond EXACT_UP_TO it is the normal form. Source: R. J. Connor, "Sample size for testing
    differences in proportions for the paired-sample design", Biometrics 43 (1987).
    """
    lost, won = counts.lost / counts.n, counts.won / counts.n
    worsening, differing = lost - won, lost + won
    if worsening == tolerance:
        return math.inf
    spread = POWER_QUANTILE * math.sqrt(max(differing - worsening**2, 0.0))
    roots = [(NORMAL_QUANTILE / POWER_QUANTILE + 1.0) * spread / abs(worsening - tolerance)]
    if worsening > tolerance:
        shown = (_two_sided(level) * math.sqrt(differing) + spread) / worsening
        roots = [shown, spread / (worsening - tolerance)]
    guess = max(roots) ** 2
    if guess > 1.2 * EXACT_UP_TO:
        return guess

    def is_enough(n: int) -> bool:
        losses, gains = _likely_counts(n, lost)[:, None], _likely_counts(n, won)
        rest = min(1.0, won / (1.0 - lost)) if lost < 1.0 else 0.0
        chances = scipy.stats.binom.pmf(losses, n, lost) * scipy.stats.binom.pmf(
            gains, n - losses, rest
        )
        if worsening > tolerance:
            settled = (mcnemar_p(losses, gains) <= level) & (losses - gains > tolerance * n)
        else:
            settled = score_statistic(losses, gains, n, -tolerance) > NORMAL_QUANTILE
        return bool(chances[settled].sum() >= POWER)

    high = min(max(4, math.ceil(guess)), EXACT_UP_TO)
    while not is_enough(high):
        if high == EXACT_UP_TO:
            return guess
        high = min(math.ceil(1.3 * high), EXACT_UP_TO)
    return bisect_left(range(high), True, lo=1, key=is_enough)


def _likely_counts(n: int, share: float) -> NDArray[np.float64]:
    """Return the counts of n draws, but for NEGLIGIBLE ones at either end."""
    low = scipy.stats.binom.ppf(NEGLIGIBLE, n, share)
    high = scipy.stats.binom.isf(NEGLIGIBLE, n, share)
    return np.arange(max(low, 0.0), high + 1.0)


def _for_means(worsening: float, deviation: float, level: float, tolerance: float) -> float:
    """Return the episodes for a paired t test, or for the interval of a mean.

    To show a worsening, signs alone need a few episodes as well. Source: W. C. Guenther, "Sample
    size formulas for normal theory t tests", Am. Stat. 35 (1981).
    """

    def needed(distance: float, quantile: float) -> float:
        if distance <= 0.0:
            return math.inf
        return float(((quantile + POWER_QUANTILE) * deviation / distance) ** 2 + quantile**2 / 2.0)

    if worsening > tolerance:
        shown = needed(worsening, _two_sided(level))
        return max(shown, needed(worsening - tolerance, 0.0), math.ceil(math.log2(2.0 / level)))
    return max(needed(tolerance - worsening, NORMAL_QUANTILE), FEWEST_FOR_A_MEAN)


def _two_sided(level: float) -> float:
    return NormalDist().inv_cdf(1.0 - level / 2.0)
