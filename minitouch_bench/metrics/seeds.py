"""Differences of means over training seeds, with what is known of them from seeds and episodes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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


def mean_p_values(strata: Sequence[Sequence[Floats]]) -> Floats:
    """Return the p-values of all pairs of means over strata (tasks), (N, N), 1 on the diagonal."""
    return mean_differences(strata).p_values


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
    for samples in strata:
        table = np.array([values.mean(axis=0) for values in samples])
        means = table.mean(axis=1)
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
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(spread > 0, variance**2 / spread, 1.0)
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
