"""The estimates of a board's row, and the ranks of all rows with their uncertainty.

Estimates are those in ``run.json``, over training seeds where there are several; nothing is
estimated over episodes here. A rank is 1 + the number of rows that are significantly better: all
rows face the same episodes, so every two of them are compared episode by episode.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Count
from minitouch_bench.metrics import intervals
from minitouch_bench.metrics.definitions import METRICS, ShownIn, ranking_metric
from minitouch_bench.metrics.statistics import ALPHA, SHARE, holm, mcnemar_p, seeds_to_decide
from minitouch_bench.metrics.summary import Gap
from minitouch_bench.protocol.minitouch import DARK, GOAL_TASKS, MAIN_SUITE, PROTOCOL
from minitouch_bench.protocol.spec import Split
from minitouch_bench.reporting.labels import TASKS
from minitouch_bench.runs.run import Run

MEAN_SUCCESS = "mean_success"
"""The board's own metric: the mean of the success rates of the tasks with a goal."""

BOARD_TASKS = tuple(task for task in TASKS if task in PROTOCOL.suite(MAIN_SUITE).tasks)
"""The tasks of the main suite, in the order of every table."""
BOARD_GOALS = tuple(task for task in BOARD_TASKS if task in GOAL_TASKS)

OVERALL = "overall"
"""The key of the main suite's tasks together."""

MEAN_KEYS: Mapping[str, str] = {MAIN_SUITE: OVERALL, DARK: DARK}
"""By suite, the key of the mean success over its tasks with a goal."""


def board_key(suite: str, task: str) -> str:
    """Return the key of a task of a suite, of which the board ranks the rows."""
    return task if suite == MAIN_SUITE else f"{suite}/{task}"


MEAN_OF: Mapping[str, tuple[str, ...]] = {
    key: tuple(board_key(suite, task) for task in PROTOCOL.suite(suite).tasks if task in GOAL_TASKS)
    for suite, key in MEAN_KEYS.items()
}
"""By the key of a mean, the keys of the tasks that it is of."""

RANKED_BY: Mapping[str, str] = {
    **dict.fromkeys(MEAN_OF, MEAN_SUCCESS),
    **{task: ranking_metric(task) for task in BOARD_TASKS},
    **{
        board_key(suite.name, task): ranking_metric(task)
        for suite in PROTOCOL.suites
        if suite.rankable and suite.name != MAIN_SUITE
        for task in suite.tasks
    },
}
"""What ranks the rows, by the key of the table: each is a family of tests of its own."""

BOARD_METRICS = tuple(
    name for name, metric in METRICS.items() if metric.shown_in & (ShownIn.TABLE4 | ShownIn.BOARD)
)
"""The metrics that a board shows, in each task that has them."""

Figures = dict[str, dict[str, intervals.Estimate]]
"""A row's estimates by the key of a table, then by metric."""

RunsBySuite = Mapping[str, Sequence[Run]]
"""By suite, a run of each training."""


def score(runs: RunsBySuite) -> Figures:
    """Return the estimates that all trainings have, by the key of their table.

    On novel shapes it is the metric that ranks a task, over the held-out shapes.
    """
    figures: Figures = {}
    for suite, of_trainings in runs.items():
        for task in PROTOCOL.suite(suite).tasks:
            found = figures[board_key(suite, task)] = {}
            for metric in BOARD_METRICS:
                estimates = [*filter(None, (_estimate(run, task, metric) for run in of_trainings))]
                if len(estimates) == len(of_trainings):
                    possible = METRICS[metric].range_in(task)
                    found[metric] = intervals.over_seeds(estimates, possible)
    for suite, key in MEAN_KEYS.items():
        if suite not in runs:
            continue
        number = len(runs[suite])
        # Trainings of one task are independent of those of another, so their seeds are not paired.
        mean = intervals.quadrature([figures[part]["success"] for part in MEAN_OF[key]])
        if number > 1:
            method = f"{intervals.OVER_SEEDS}; {intervals.OVER_TASKS}"
            mean = replace(mean, count=number, method=method)
        figures[key] = {MEAN_SUCCESS: mean}
    return figures


def _estimate(run: Run, task: str, metric: str) -> intervals.Estimate | None:
    if not PROTOCOL.suite(run.plan.suite).novel_shapes:
        return run[task].estimates.get(metric)
    gaps = next((one.gaps for one in run.summary.generalization if one.task == task), {})
    return gaps[metric].held_out if metric in gaps and metric == ranking_metric(task) else None


def values_by_key(runs: RunsBySuite) -> dict[str, list[list[float]]]:
    """Return the values that rank the rows: by key, a list per training, a value per episode.

    On novel shapes these are the episodes with held-out shapes.
    """
    found = {}
    for suite, of_trainings in runs.items():
        spec = PROTOCOL.suite(suite)
        for task in spec.tasks:
            key = board_key(suite, task)
            metric = METRICS[RANKED_BY[key]]
            found[key] = [
                metric.values(
                    row
                    for row in run.rows
                    if row.task == task and (not spec.novel_shapes or row.split == Split.HELD_OUT)
                )
                for run in of_trainings
            ]
    return found


FLOOR_SUCCESS: Mapping[str, float] = {"pushing": 0.11, "opening": 0.30, "pick-up": 0.03}
"""The highest success in Table 4 of a policy that learned nothing: random, zero or open-loop.

A training seed **learned** a task where the lower end of its success's 95 % interval lies above
this value. Without that count a mean over seeds hides that some seeds fail, and where some do,
no interval over a few seeds holds its level. A new task with a goal needs its entry.
"""


def count_learned(runs: RunsBySuite) -> dict[str, int]:
    """Return how many training seeds learned each task with a goal, see FLOOR_SUCCESS.

    By the key of the task's table; not on novel shapes. The floors do not look at the image, so
    they are the same in the dark.
    """
    return {
        board_key(suite, task): sum(
            run[task].success.low > FLOOR_SUCCESS[task] for run in runs[suite]
        )
        for suite in MEAN_KEYS
        if suite in runs
        for task in PROTOCOL.suite(suite).tasks
        if task in GOAL_TASKS
    }


def score_gaps(runs: Sequence[Run]) -> dict[str, Gap]:
    """Return the gap of each task's ranking metric, by the runs of all training seeds."""
    found = {}
    for task in runs[0].tasks if runs else ():
        metric, parts = ranking_metric(task), {}
        results = (one for run in runs for one in run.summary.generalization if one.task == task)
        gaps = [result.gaps[metric] for result in results]
        for part in (field.name for field in fields(Gap)):
            possible = METRICS[metric].range_in(task, difference=part == "difference")
            parts[part] = intervals.over_seeds([getattr(gap, part) for gap in gaps], possible)
        found[task] = Gap(**parts)
    return found


@dataclass(frozen=True)
class Rank:
    """A row's rank: 1 + the number of better rows; ``worst``: all rows less the worse ones.

    Better and worse rows are those that differ significantly.
    """

    best: int
    worst: int

    def __str__(self) -> str:
        return f"{self.best} to {self.worst}" if self.worst > self.best else f"{self.best}"


@dataclass(frozen=True)
class Pair:
    """Two rows of a table, of which ``higher`` has the greater value, by ``difference``.

    ``p`` is corrected for all pairs of the table (Holm). ``is_significant``: it is at most 0.05, or
    a row between the two is significantly different from both. ``seeds``: about how many training
    seeds of each row would settle a case that is not, see ``seeds_to_decide``; None where unknown.
    """

    higher: str
    lower: str
    difference: float
    p: float
    is_significant: bool
    seeds: Count | None


@dataclass(frozen=True)
class Ranking:
    """The ranks of a table's rows by name, and all pairs of rows, the best ones first."""

    ranks: Mapping[str, Rank]
    pairs: tuple[Pair, ...]


def rank(rows: Mapping[str, Mapping[str, Sequence[Sequence[float]]]]) -> dict[str, Ranking]:
    """Rank the rows in each table that at least one of them has.

    A row has by key, of each training seed, the episodes' values in the metric that ranks it.
    """
    rankings = {}
    for key in RANKED_BY:
        parts = MEAN_OF.get(key, (key,))
        present = [name for name, row in rows.items() if row.keys() >= {*parts}]
        if not present:
            continue
        samples = [[np.array(rows[name][part]) for name in present] for part in parts]
        seeds = {name: len(rows[name][parts[0]]) for name in present}
        found = intervals.mean_differences(samples)
        is_share = len(parts) == 1 and METRICS[RANKED_BY[key]].statistic == SHARE
        p_values = share_p_values(samples[0], found) if is_share else found.p_values
        rankings[key] = _rank_table(found, p_values, seeds)
    return rankings


def _rank_table(
    found: intervals.MeanDifferences, p_values: intervals.Floats, seeds: Mapping[str, int]
) -> Ranking:
    """Rank the rows of a table, each with its name and number of training seeds in ``seeds``."""
    names, means = tuple(seeds), found.value[:, 0]  # less that of the first row
    corrected, better = judge_pairs(means, p_values)
    undecided = int((np.triu(corrected, 1) > ALPHA).sum())
    pairs = []
    for pair in combinations(np.argsort(-means, kind="stable").tolist(), 2):
        higher, lower = (names[row] for row in pair)
        p = float(f"{corrected[pair]:.4g}")  # further digits depend on the library
        both = seeds[higher], seeds[lower]
        number = (
            None if better[pair] else seeds_to_decide(found, both, ALPHA / undecided, pair=pair)
        )
        difference = round(float(found.value[pair]), intervals.DIGITS)
        pairs.append(Pair(higher, lower, difference, p, bool(better[pair]), number))
    return Ranking(dict(zip(names, ranks_of(better), strict=True)), tuple(pairs))


def judge_pairs(
    means: intervals.Floats, p_values: intervals.Floats
) -> tuple[intervals.Floats, NDArray[np.bool_]]:
    """Return the corrected p-values, (N, N), and whether a row is better than another, (N, N).

    All pairs of the table are one family, judged together at 5 % (Holm). So A is better than B
    exactly where B is worse than A. A row that is better than another is also better than all
    that the other is better than: if both findings are true, this one is. Ranks therefore never
    contradict a finding: the better row's rank is the smaller one.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Stat.
    6 (1979).
    """
    pairs = np.triu_indices(len(means), 1)
    corrected = np.ones((len(means),) * 2)
    corrected[pairs] = holm(p_values[pairs].tolist())
    corrected = np.minimum(corrected, corrected.T)
    better = (corrected <= ALPHA) & (means[:, None] > means[None, :])
    for row in np.argsort(means):  # each row's findings are whole before those above it use them
        better[row] |= better[better[row]].any(axis=0)
    return corrected, better


def ranks_of(better: NDArray[np.bool_]) -> tuple[Rank, ...]:
    """Return the rank of each row, of ``judge_pairs``."""
    above, below = better.sum(axis=0), better.sum(axis=1)
    return tuple(Rank(1 + int(a), len(better) - int(b)) for a, b in zip(above, below, strict=True))


def share_p_values(
    samples: Sequence[intervals.Floats], found: intervals.MeanDifferences
) -> intervals.Floats:
    """Return the p-values of all pairs of success rates, (N, N), 1 on the diagonal.

    ``samples``: each row's values of a task, float64 (S, E): training seeds by episodes.
    Two rows of one training seed: exact McNemar on the episodes that one wins and the other
    loses, as ``compare`` has it. Otherwise those of ``found``, the differences of their means.
    """
    single = np.array([len(values) == 1 for values in samples], bool)
    p_values = found.p_values
    if single.any():
        won = np.array([values[0] for values in samples if len(values) == 1])
        only_one = np.rint(won @ (1 - won).T).astype(int)
        p_values[np.ix_(single, single)] = mcnemar_p(only_one, only_one.T)
    return p_values
