"""Ranks with their uncertainty: 1 + the number of rows that are significantly better.

All rows face the same episodes, so every two of them are compared episode by episode.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

from minitouch_bench.leaderboard.scores import OVERALL
from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS
from minitouch_bench.metrics.significance import ALPHA, holm
from minitouch_bench.regression.differences import mcnemar_p

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Rank:
    """A row's rank: 1 + the rows that are better beyond doubt. ``worst`` is the last it may be."""

    best: int
    worst: int


def rank(rows: Sequence[Mapping[str, Sequence[Sequence[float]]]]) -> list[dict[str, Rank]]:
    """Rank submissions in each task and overall; one mapping per row, in their order.

    A row has by task, of each training seed, the episodes' values in the metric that ranks it.
    """
    if not rows:
        return []
    ranks: dict[str, list[Rank]] = {}
    samples = {task: [np.array(row[task]) for row in rows] for task in BOARD_TASKS}
    for task in BOARD_TASKS:
        compare = share_p_values if task in BOARD_GOALS else lambda rows: mean_p_values([rows])
        means = np.array([values.mean() for values in samples[task]])
        ranks[task] = ranks_of(means, compare(samples[task]))
    strata = [samples[task] for task in BOARD_GOALS]
    overall = np.mean([[values.mean() for values in rows] for rows in strata], axis=0)
    ranks[OVERALL] = ranks_of(overall, mean_p_values(strata))
    return [dict(zip(ranks, of_row, strict=True)) for of_row in zip(*ranks.values(), strict=True)]


def ranks_of(means: Floats, p_values: Floats) -> list[Rank]:
    """Return the rank of each row, more being better.

    A row's comparisons with the others are judged together at 5 % (Holm), so its range from
    ``best`` to ``worst`` holds its true rank with 95 % confidence.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Stat.
    6 (1979); M. Mogstad et al., "Inference for ranks", Rev. Econ. Stud. 91 (2024).
    """
    number = len(means)
    apart = np.zeros((number, number), bool)
    for row, others in enumerate(~np.eye(number, dtype=bool)):
        apart[row, others] = np.array(holm(p_values[row, others])) <= ALPHA
    better = (apart & (means[None, :] > means[:, None])).sum(axis=1)
    worse = (apart & (means[None, :] < means[:, None])).sum(axis=1)
    return [Rank(1 + int(b), number - int(w)) for b, w in zip(better, worse, strict=True)]


def share_p_values(samples: Sequence[Floats]) -> Floats:
    """Return the p-values of all pairs of success rates, (N, N), 1 on the diagonal.

    ``samples``: each row's values of a task, float64 (S, E): training seeds by episodes.
    Two rows of one training seed: exact McNemar on the episodes that one wins and the other
    loses, as ``compare`` has it. Otherwise ``mean_p_values``.
    """
    single = np.array([len(values) == 1 for values in samples], bool)
    p_values = np.ones((len(samples),) * 2) if single.all() else mean_p_values([samples])
    if single.any():
        won = np.array([values[0] for values in samples if len(values) == 1])
        only_one = np.rint(won @ (1 - won).T).astype(int)
        exact = _mcnemar_table(won.shape[1])[only_one, only_one.T]
        p_values[np.ix_(single, single)] = exact
    return p_values


def mean_p_values(strata: Sequence[Sequence[Floats]]) -> Floats:
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
        table = np.array([values.mean(axis=0) for values in samples])
        means = table.mean(axis=1)
        difference += (means[:, None] - means[None, :]) / tasks
        for part, freedom in _variances(samples, table):
            variance += part / tasks**2
            spread += (part / tasks**2) ** 2 / freedom
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(difference == 0, 0.0, difference / np.sqrt(variance))
        freedom = np.where(spread > 0, variance**2 / spread, 1.0)
    upper = np.triu_indices(number, 1)
    p_values = np.ones((number, number))
    p_values[upper] = 2.0 * scipy.special.stdtr(freedom[upper], -np.abs(t[upper]))
    return np.minimum(p_values, p_values.T)


def _variances(samples: Sequence[Floats], table: Floats) -> list[tuple[Floats, float | Floats]]:
    """Return the parts of the variance of all differences in one task, with their freedom."""
    episodes = table.shape[1]
    covariance = np.atleast_2d(np.cov(table)) / episodes
    single = np.diag(covariance)
    paired = np.maximum(single[:, None] + single[None, :] - 2 * covariance, 0.0)
    paired[paired < 1e-12 * (single[:, None] + single[None, :])] = 0.0  # rounding of equal rows
    of_seeds = np.array([_seed_variance(values) for values in samples])
    freedom = np.array([max(1, len(values) - 1) for values in samples], np.float64)
    shape = paired.shape
    return [
        (paired, float(episodes - 1)),
        (np.broadcast_to(of_seeds[:, None], shape), np.broadcast_to(freedom[:, None], shape)),
        (np.broadcast_to(of_seeds[None, :], shape), np.broadcast_to(freedom[None, :], shape)),
    ]


def _seed_variance(values: Floats) -> float:
    """Return the variance of the mean over training seeds, 0 where one seed tells nothing."""
    return float(values.mean(axis=1).var(ddof=1)) / len(values) if len(values) > 1 else 0.0


@cache
def _mcnemar_table(episodes: int) -> Floats:
    """Return the two-sided exact p-value by the two counts of discordant episodes."""
    lost, won = np.indices((episodes + 1, episodes + 1))
    return mcnemar_p(lost, won)
