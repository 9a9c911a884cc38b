"""How many episodes settle whether two policies differ."""

import math
from statistics import NormalDist

import numpy as np

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
)

POWER_QUANTILE = NormalDist().inv_cdf(POWER)

MOST_EPISODES = 1_000_000
"""No larger number of episodes is ever asked for."""

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
    """Return about how many episodes the McNemar test takes, or Tango's interval.

    1 / worsening corrects the test's normal form for its exact tails; where all pairs that differ
    are lost, signs need a few of them. Source: R. J. Connor, "Sample size for testing differences
    in proportions for the paired-sample design", Biometrics 43 (1987).
    """
    lost, won = counts.lost / counts.n, counts.won / counts.n
    worsening, differing = lost - won, lost + won
    distance = abs(worsening - tolerance)
    if distance == 0.0:
        return math.inf
    spread = POWER_QUANTILE * math.sqrt(max(differing - worsening**2, 0.0))
    if worsening > tolerance:
        shown = (_two_sided(level) * math.sqrt(differing) + spread) / worsening
        signs = math.log2(2.0 / level) / differing
        return max(shown**2 + 1.0 / worsening, signs, (spread / distance) ** 2)
    excluded = (NORMAL_QUANTILE / POWER_QUANTILE + 1.0) * spread / distance
    return max(excluded**2, NORMAL_QUANTILE**2 * (1.0 / distance - 1.0))


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
