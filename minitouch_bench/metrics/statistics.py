"""What the episodes' values of a metric are condensed to: a share or a mean.

Each metric names its statistic, and a statistic brings all that a table needs of it: the estimate
with its interval, the difference of two sets of episodes, and the test of two policies on the same
episodes. A new one is a class here; nothing falls back on a mean.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from statistics import NormalDist
from typing import Final, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from minitouch_bench.metrics.intervals import (
    DRAWS_PER_BLOCK,
    NORMAL_QUANTILE,
    RESAMPLES,
    Estimate,
    Floats,
    MeanDifferences,
    Values,
    bootstrap,
    newcombe,
    wilson,
)

Rng = np.random.Generator


class PairedResult(NamedTuple):
    """A difference over the same episodes, and how surprising it is between equal policies."""

    estimate: Estimate
    p_value: float


class Share:
    """The share of the episodes whose value is 1; the others have 0."""

    interval = "Wilson for shares"
    paired = "Tango's score interval and the exact McNemar test for shares of episodes"

    def estimate(self, values: Values, rng: Rng) -> Estimate:
        """Estimate the share with Wilson's interval; nothing is drawn."""
        return wilson(int(sum(values)), len(values))

    def difference(self, first: Values, second: Values, rng: Rng) -> Estimate:
        """Estimate the difference with Newcombe's interval; nothing is drawn."""
        return newcombe(self.estimate(first, rng), self.estimate(second, rng))

    def paired_test(self, first: Floats, second: Floats, rng: Rng) -> PairedResult:
        """Estimate the difference with Tango's interval, by the exact McNemar test."""
        lost, won, n = count_discordance(first, second)
        return PairedResult(tango(lost, won, n), float(mcnemar_p(lost, won)))

    def episodes_needed(self, worse: Floats, level: float, tolerance: float) -> float:
        """Return the episodes of the McNemar test, or of Tango's interval.

        1 / worsening corrects the test's normal form for its exact tails; where all pairs that
        differ are lost, signs need a few of them. Source: R. J. Connor, "Sample size for testing
        differences in proportions for the paired-sample design", Biometrics 43 (1987).
        """
        worsening, differing = float(worse.mean()), float(np.abs(worse).mean())
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


class Mean:
    """The mean over the episodes."""

    interval = "bootstrap over episodes for means (too narrow where few of them carry the mean)"
    paired = "BCa bootstrap and flips of signs for means"

    def estimate(self, values: Values, rng: Rng) -> Estimate:
        """Estimate the mean with the BCa bootstrap."""
        return bootstrap((values,), rng)

    def difference(self, first: Values, second: Values, rng: Rng) -> Estimate:
        """Estimate the difference with the BCa bootstrap, each sample resampled by itself."""
        return bootstrap((first, second), rng)

    def paired_test(self, first: Floats, second: Floats, rng: Rng) -> PairedResult:
        """Estimate the mean difference with the BCa bootstrap, by flips of its signs.

        The interval is too narrow where few episodes differ or a few carry the difference.
        """
        differences = second - first
        return PairedResult(bootstrap((differences,), rng), sign_flip_p(differences, rng))

    def episodes_needed(self, worse: Floats, level: float, tolerance: float) -> float:
        """Return the episodes of a paired t test, or of the interval of a mean.

        To show a worsening, signs alone need a few episodes as well. Source: W. C. Guenther,
        "Sample size formulas for normal theory t tests", Am. Stat. 35 (1981).
        """
        worsening = float(worse.mean())
        deviation = float(worse.std(ddof=1)) if len(worse) > 1 else 0.0

        def needed(distance: float, quantile: float) -> float:
            if distance <= 0.0:
                return math.inf
            return ((quantile + POWER_QUANTILE) * deviation / distance) ** 2 + quantile**2 / 2.0

        if worsening > tolerance:
            shown = needed(worsening, _two_sided(level))
            return max(shown, needed(worsening - tolerance, 0.0), math.ceil(math.log2(2 / level)))
        return max(needed(tolerance - worsening, NORMAL_QUANTILE), FEWEST_FOR_A_MEAN)


Statistic = Share | Mean
"""A number that describes the values of many episodes, and what a table needs of it.

Over tasks with equally many episodes, the mean of its values is its value of all episodes.
``interval`` and ``paired`` say in words how it is estimated and how two policies are compared.
``difference``: the first less the second, of episodes that are not the same ones. ``paired_test``:
the second less the first, float64 (N,) each of the same N episodes. ``episodes_needed``: about how
many episodes settle a difference in four of five cases, as observed, infinity where no number does;
``worse``: how much worse each paired episode is, float64 (N,); ``level``: two-sided, of the test of
a difference; ``tolerance``: a worsening by more is to be shown, one by less to be excluded by the
95 % interval.
"""

SHARE, MEAN = Share(), Mean()


ALPHA: Final = 0.05
"""A p-value up to this is significant."""

ALPHA_IN_WORDS: Final = f"{100 * ALPHA:g} %"

POWER: Final = 0.8
"""A difference is called detectable if so large a share of equal experiments would show it."""

POWER_QUANTILE = NormalDist().inv_cdf(POWER)

FEWEST_FOR_A_MEAN = 10
"""Episodes below which no bound of a mean is believed."""

TANGO = "tango"

HALVINGS = 60
"""Of an interval of length 2, to the last bit of a float."""

EXACT_FLIPS = 13
"""Up to so many differences that are not 0, every choice of signs is tried."""


def _two_sided(level: float) -> float:
    return NormalDist().inv_cdf(1.0 - level / 2.0)


def count_discordance(first: Floats, second: Floats) -> tuple[int, int, int]:
    """Count the pairs that only the first, only the second run succeeds in, and all.

    The values are 1 for success and 0, float64 (N,) each.
    """
    return int((first > second).sum()), int((second > first).sum()), len(first)


def mcnemar_p(lost: ArrayLike, won: ArrayLike) -> Floats:
    """Return the two-sided p-value of the exact McNemar test, elementwise.

    ``lost`` and ``won`` count the pairs of which only the first, only the second succeeds.
    Given their number, each is as likely as the other where the policies are equally good.
    Without such a pair the value is 1. ``scipy.stats.binomtest`` gives the same, one by one.

    Source: Q. McNemar, "Note on the sampling error of the difference between correlated
    proportions or percentages", Psychometrika 12 (1947), with exact binomial tails.
    """
    tails: Floats = scipy.stats.binom.cdf(np.minimum(lost, won), np.add(lost, won), 0.5)
    return np.minimum(1.0, 2.0 * tails)


def tango(lost: int, won: int, n: int, quantile: float = NORMAL_QUANTILE) -> Estimate:
    """Estimate the difference of two paired shares, second minus first, of ``n`` pairs.

    ``lost`` and ``won`` count the pairs of which only the first, only the second succeeds.

    The score interval: every difference that the score test does not reject. It stays inside
    -1 to 1 and has a width at 0 and at 100 % too, and where no pair differs. scipy has none
    for paired shares.

    Source: T. Tango, "Equivalence test and confidence interval for the difference in
    proportions for the paired-sample design", Stat. Med. 17 (1998).
    """
    low, high = _lower_end(lost, won, n, quantile), -_lower_end(won, lost, n, quantile)
    return Estimate((won - lost) / n, low, high, n, TANGO)


def _lower_end(lost: int, won: int, n: int, quantile: float) -> float:
    """Return the least difference that the score test does not reject, by halving."""
    low, high = -1.0, (won - lost) / n
    for _ in range(HALVINGS if lost < n else 0):
        middle = (low + high) / 2.0
        is_rejected = score_statistic(lost, won, n, middle) > quantile
        low, high = (middle, high) if is_rejected else (low, middle)
    return low


def score_statistic(lost: int, won: int, n: int, difference: float) -> float:
    """Return Tango's score statistic for a supposed difference in (-1, 1).

    It is standard normal where the supposition holds, and falls as the supposed difference grows.
    A variance of 0 gives 0 or infinity.
    """
    b = -won - lost + (2 * n - won + lost) * difference
    c = -lost * difference * (1.0 - difference)
    share = (math.sqrt(max(b * b - 8.0 * n * c, 0.0)) - b) / (4.0 * n)
    variance = max(n * (2.0 * share + difference * (1.0 - difference)), 0.0)
    distance = won - lost - n * difference
    if variance == 0.0:
        return math.copysign(math.inf, distance) if distance else 0.0
    return distance / math.sqrt(variance)


def sign_flip_p(differences: Floats, rng: Rng, resamples: int = RESAMPLES) -> float:
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
    block = max(1, DRAWS_PER_BLOCK // len(sizes))  # so that memory stays small
    for begun in range(0, resamples, block):
        count = min(block, resamples - begun)
        octets = rng.integers(256, size=(count, -(-len(sizes) // 8)), dtype=np.uint8)
        positive = np.unpackbits(octets, axis=1, count=len(sizes)).astype(np.float64)
        sums = 2.0 * (positive @ sizes) - sizes.sum()
        as_large += int(np.count_nonzero(np.abs(sums) >= observed))
    return (1 + as_large) / (1 + resamples)


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


MAX_SEEDS = 1000
"""Training seeds of each of two methods beyond which no number is given."""


def seeds_to_decide(
    found: MeanDifferences,
    seeds: tuple[int, int],
    level: float,
    difference: float | None = None,
    pair: tuple[int, int] = (0, 1),
) -> int | None:
    """Return about how many training seeds of each of two rows would show which one is better.

    With so many seeds, in place of the ``seeds`` that there are, the test of ``found`` would be
    significant at ``level`` with probability POWER, by the noncentral t distribution, if
    ``difference``, by default that seen, is the true one, the means of seeds are normal with the
    variances seen, and the episodes are the same ones. It is a guess: if the true difference is
    half of that seen, about four times as many are needed. None: a row has one seed, which says
    nothing of their variance, or the number is above MAX_SEEDS.
    """
    distance = abs(float(found.value[pair])) if difference is None else difference
    if min(seeds) == 1 or distance <= 0:
        return None
    there = float(scipy.stats.hmean(seeds))
    kept = float(found.over_episodes[pair])
    of_one_seed = (float(found.variance[pair]) - kept) * there

    def is_decided(number: int) -> bool:
        freedom = float(found.freedom[pair]) * (number - 1) / (there - 1)
        limit = scipy.special.stdtrit(freedom, 1.0 - level / 2.0)
        variance = kept + of_one_seed / number
        errors = distance / math.sqrt(variance) if variance > 0.0 else math.inf
        # Not `<=`: scipy gives nan for some differences that are missed with a chance of about 0.
        return not scipy.special.nctdtr(freedom, errors, limit) > 1.0 - POWER

    numbers = range(2, MAX_SEEDS + 1)
    place = bisect_left(numbers, True, key=is_decided)
    return numbers[place] if place < len(numbers) else None
