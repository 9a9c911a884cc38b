"""What the episodes' values of a metric are condensed to: a share, a mean, a quantile.

Each metric names its statistic, and a statistic brings all that a table needs of it: the estimate
with its interval, the difference of two sets of episodes, and the test of two policies on the same
episodes. A new one is a class here; nothing falls back on a mean.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from minitouch_bench.metrics.intervals import (
    Estimate,
    bootstrap,
    bootstrap_difference,
    bootstrap_mean,
    newcombe,
    wilson,
)
from minitouch_bench.metrics.significance import count_discordance, sign_flip_p, tango

Floats = NDArray[np.float64]

SWAPS = 2_000
"""Exchanges of paired values that the test of a quantile draws."""


class PairedResult(NamedTuple):
    """A difference over the same episodes, and how surprising it is between equal policies."""

    estimate: Estimate
    p_value: float


class Statistic(ABC):
    """A number that describes the values of many episodes.

    ``interval`` and ``paired`` say in words how it is estimated and how two policies are compared.
    ``is_additive``: over tasks with equally many episodes, its mean is its value of all episodes.
    """

    interval: str
    paired: str
    is_additive: bool

    @abstractmethod
    def value(self, values: Floats) -> float:
        """Return the statistic of values, float64 (N,)."""

    @abstractmethod
    def estimate(self, values: Sequence[float], rng: np.random.Generator) -> Estimate:
        """Estimate the statistic with its 95 % interval."""

    @abstractmethod
    def difference(
        self, first: Sequence[float], second: Sequence[float], rng: np.random.Generator
    ) -> Estimate:
        """Estimate the first less the second, of episodes that are not the same ones."""

    @abstractmethod
    def paired_test(self, first: Floats, second: Floats, rng: np.random.Generator) -> PairedResult:
        """Estimate the second less the first, float64 (N,) each of the same N episodes."""


@dataclass(frozen=True)
class Share(Statistic):
    """The share of the episodes whose value is 1; the others have 0."""

    interval = "Wilson for shares"
    paired = "Tango's score interval and the exact McNemar test for shares of episodes"
    is_additive = True

    def value(self, values: Floats) -> float:
        """Return the share."""
        return float(values.mean())

    def estimate(self, values: Sequence[float], rng: np.random.Generator) -> Estimate:
        """Estimate the share with Wilson's interval; nothing is drawn."""
        return wilson(int(sum(values)), len(values))

    def difference(
        self, first: Sequence[float], second: Sequence[float], rng: np.random.Generator
    ) -> Estimate:
        """Estimate the difference with Newcombe's interval; nothing is drawn."""
        return newcombe(self.estimate(first, rng), self.estimate(second, rng))

    def paired_test(self, first: Floats, second: Floats, rng: np.random.Generator) -> PairedResult:
        """Estimate the difference with Tango's interval, by the exact McNemar test."""
        discordance = count_discordance(first, second)
        return PairedResult(tango(discordance), discordance.p_value)


@dataclass(frozen=True)
class Mean(Statistic):
    """The mean over the episodes."""

    interval = "bootstrap over episodes for means (too narrow where few of them carry the mean)"
    paired = "BCa bootstrap and flips of signs for means"
    is_additive = True

    def value(self, values: Floats) -> float:
        """Return the mean."""
        return float(values.mean())

    def estimate(self, values: Sequence[float], rng: np.random.Generator) -> Estimate:
        """Estimate the mean with the BCa bootstrap."""
        return bootstrap_mean(values, rng)

    def difference(
        self, first: Sequence[float], second: Sequence[float], rng: np.random.Generator
    ) -> Estimate:
        """Estimate the difference with the BCa bootstrap, each sample resampled by itself."""
        return bootstrap_difference(first, second, rng)

    def paired_test(self, first: Floats, second: Floats, rng: np.random.Generator) -> PairedResult:
        """Estimate the mean difference with the BCa bootstrap, by flips of its signs.

        The interval is too narrow where few episodes differ or a few carry the difference.
        """
        differences = second - first
        return PairedResult(bootstrap_mean(differences, rng), sign_flip_p(differences, rng))


@dataclass(frozen=True)
class Quantile(Statistic):
    """The value that a share ``level`` of the episodes do not exceed.

    The interval between two order statistics needs log(0.025) / log(level) episodes and as many
    for 1 - level: 36 for a 90th percentile. With fewer an end is the extreme value seen, and the
    interval is too narrow.
    """

    level: float
    interval = "order statistics for quantiles"
    paired = "bootstrap and exchanges within pairs for quantiles"
    is_additive = False

    def value(self, values: Floats) -> float:
        """Return the quantile: an observed value."""
        return float(self._of(values, axis=0))

    def estimate(self, values: Sequence[float], rng: np.random.Generator) -> Estimate:
        """Estimate the quantile with the interval between order statistics; nothing is drawn.

        Source: W. J. Conover, "Practical nonparametric statistics" (1999), ch. 3.2.
        """
        sample = np.asarray(values, np.float64)
        test = scipy.stats.quantile_test(sample, p=self.level)
        low, high = test.confidence_interval(confidence_level=0.95)
        value = self.value(sample)
        low = float(sample.min()) if math.isnan(low) else min(float(low), value)
        high = float(sample.max()) if math.isnan(high) else max(float(high), value)
        return Estimate(value, low, high, len(sample), "order statistics")

    def difference(
        self, first: Sequence[float], second: Sequence[float], rng: np.random.Generator
    ) -> Estimate:
        """Estimate the difference with the percentile bootstrap, each sample by itself."""
        return bootstrap((first, second), self._difference, rng, method="percentile")

    def paired_test(self, first: Floats, second: Floats, rng: np.random.Generator) -> PairedResult:
        """Estimate the difference by resampling pairs; test it by exchanges within pairs."""
        estimate = bootstrap(
            (second, first), self._difference, rng, method="percentile", paired=True
        )
        if (first == second).all():
            return PairedResult(estimate, 1.0)
        test = scipy.stats.permutation_test(
            (second, first), self._difference, permutation_type="samples", vectorized=True,
            n_resamples=SWAPS, batch=100, rng=rng,
        )  # fmt: skip
        return PairedResult(estimate, float(test.pvalue))

    def _of(self, values: Floats, axis: int) -> Floats:
        quantiles: Floats = np.quantile(values, self.level, axis=axis, method="inverted_cdf")
        return quantiles

    def _difference(self, first: Floats, second: Floats, axis: int) -> Floats:
        return self._of(first, axis) - self._of(second, axis)


SHARE, MEAN = Share(), Mean()
