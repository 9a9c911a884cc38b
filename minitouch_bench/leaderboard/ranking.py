"""Ranks with their uncertainty: rows that cannot be told apart share one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.leaderboard.pairs import Sample, mean_p_values, share_p_values
from minitouch_bench.leaderboard.scored import ScoredSubmission
from minitouch_bench.leaderboard.scores import OVERALL
from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS
from minitouch_bench.metrics import ranking_metric

ALPHA = 0.05
"""Share of rows whose range of ranks may miss the true one."""

RANKED_BY: Mapping[str, str] = {task: ranking_metric(task) for task in BOARD_TASKS}
"""What a task is ranked by; overall it is the mean success over the tasks with a goal."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Rank:
    """A row's rank: 1 + the rows that are better beyond doubt. ``worst`` is the last it may be."""

    best: int
    worst: int

    def __str__(self) -> str:
        return str(self.best)


def rank(rows: Sequence[ScoredSubmission]) -> list[dict[str, Rank]]:
    """Rank submissions in each task and overall; one mapping per row, in their order."""
    ranks: list[dict[str, Rank]] = [{} for _ in rows]
    if not rows:
        return ranks
    samples = {task: [Sample(np.array(row.values[task])) for row in rows] for task in BOARD_TASKS}
    for task in BOARD_TASKS:
        compare = share_p_values if task in BOARD_GOALS else lambda own: mean_p_values([own])
        means = np.array([sample.values.mean() for sample in samples[task]])
        _keep(ranks, task, means, compare(samples[task]))
    strata = [samples[task] for task in BOARD_GOALS]
    overall = np.mean([[sample.values.mean() for sample in own] for own in strata], axis=0)
    _keep(ranks, OVERALL, overall, mean_p_values(strata))
    return ranks


def ranks_of(means: Floats, p_values: Floats) -> list[Rank]:
    """Return the rank of each row, more being better.

    A row's comparisons with the others are judged together at 5 % (Holm), so its range from
    ``best`` to ``worst`` holds its true rank with 95 % confidence.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Stat.
    6 (1979); M. Mogstad et al., "Inference for ranks", Rev. Econ. Stud. 91 (2024).
    """
    number = len(means)
    apart = _holm(p_values)
    better = (apart & (means[None, :] > means[:, None])).sum(axis=1)
    worse = (apart & (means[None, :] < means[:, None])).sum(axis=1)
    return [Rank(1 + int(b), number - int(w)) for b, w in zip(better, worse, strict=True)]


def _holm(p_values: Floats) -> NDArray[np.bool_]:
    """Return which comparisons of each row are significant at ALPHA after Holm's correction."""
    number = len(p_values)
    if number < 2:
        return np.zeros((number, number), bool)
    own = p_values.copy()
    np.fill_diagonal(own, 2.0)  # comes last in every row, and is never significant
    order = np.argsort(own, axis=1, kind="stable")
    limits = ALPHA / np.maximum(number - 1 - np.arange(number), 1)
    passed = np.logical_and.accumulate(np.take_along_axis(own, order, 1) <= limits, axis=1)
    found = np.zeros((number, number), bool)
    np.put_along_axis(found, order, passed, 1)
    return found


def _keep(ranks: list[dict[str, Rank]], key: str, means: Floats, p_values: Floats) -> None:
    for own, found in zip(ranks, ranks_of(means, p_values), strict=True):
        own[key] = found
