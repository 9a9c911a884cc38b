"""Which rows can be told apart: a paired p-value for every two of them.

All rows face the same episodes, so each pair is compared episode by episode.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from minitouch_bench.regression.shares import mcnemar_p

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sample:
    """One row's values of one task, float64 (S, E): training seeds by episodes."""

    values: Floats

    @property
    def is_single(self) -> bool:
        """Whether there is one training seed only."""
        return len(self.values) == 1


def share_p_values(samples: Sequence[Sample]) -> Floats:
    """Return the p-values of all pairs of success rates, (N, N), 1 on the diagonal.

    Two rows of one training seed: exact McNemar on the episodes that one wins and the other
    loses, as ``compare`` has it. Otherwise ``mean_p_values``.
    """
    single = np.array([sample.is_single for sample in samples], bool)
    found = np.ones((len(samples),) * 2) if single.all() else mean_p_values([samples])
    if single.any():
        won = np.array([sample.values[0] for sample in samples if sample.is_single])
        only_one = np.rint(won @ (1 - won).T).astype(int)
        exact = _mcnemar_table(won.shape[1])[only_one, only_one.T]
        found[np.ix_(single, single)] = exact
    return found


def mean_p_values(strata: Sequence[Sequence[Sample]]) -> Floats:
    """Return the p-values of all pairs of means over strata (tasks), (N, N).

    ``strata`` holds the rows' samples of each task. The variance of a difference has two
    parts: of the paired differences over episodes, and, for a row of several training seeds,
    of its seeds' means. Student's t with the degrees of freedom of Satterthwaite.

    Source: F. E. Satterthwaite, "An approximate distribution of estimates of variance
    components", Biometrics Bulletin 2 (1946).
    """
    number, tasks = len(strata[0]), len(strata)
    difference, variance, spread = (np.zeros((number, number)) for _ in range(3))
    for samples in strata:
        table = np.array([sample.values.mean(axis=0) for sample in samples])
        means = table.mean(axis=1)
        difference += (means[:, None] - means[None, :]) / tasks
        for part, freedom in _variances(samples, table):
            variance += part / tasks**2
            spread += (part / tasks**2) ** 2 / freedom
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(difference == 0, 0.0, difference / np.sqrt(variance))
        freedom = np.where(spread > 0, variance**2 / spread, 1.0)
    upper = np.triu_indices(number, 1)
    found = np.ones((number, number))
    found[upper] = 2.0 * stats.t.sf(np.abs(t[upper]), freedom[upper])
    return np.minimum(found, found.T)


def _variances(samples: Sequence[Sample], table: Floats) -> list[tuple[Floats, float | Floats]]:
    """Return the parts of the variance of all differences in one task, with their freedom."""
    episodes = table.shape[1]
    covariance = np.atleast_2d(np.cov(table)) / episodes
    own = np.diag(covariance)
    paired = np.maximum(own[:, None] + own[None, :] - 2 * covariance, 0.0)
    paired[paired < 1e-12 * (own[:, None] + own[None, :])] = 0.0  # rounding of equal rows
    of_seeds = np.array([_seed_variance(sample) for sample in samples])
    freedom = np.array([max(1, len(sample.values) - 1) for sample in samples], np.float64)
    shape = paired.shape
    return [
        (paired, float(episodes - 1)),
        (np.broadcast_to(of_seeds[:, None], shape), np.broadcast_to(freedom[:, None], shape)),
        (np.broadcast_to(of_seeds[None, :], shape), np.broadcast_to(freedom[None, :], shape)),
    ]


def _seed_variance(sample: Sample) -> float:
    """Return the variance of the mean over training seeds, 0 where one seed tells nothing."""
    if sample.is_single:
        return 0.0
    return float(sample.values.mean(axis=1).var(ddof=1)) / len(sample.values)


@cache
def _mcnemar_table(episodes: int) -> Floats:
    """Return the two-sided exact p-value by the two counts of discordant episodes."""
    lost, won = np.indices((episodes + 1, episodes + 1))
    return mcnemar_p(lost, won)
