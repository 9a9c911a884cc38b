"""The estimates of a board's row, and the ranks of all rows with their uncertainty.

Estimates are those in ``run.json``, over training seeds where there are several; nothing is
estimated over episodes here. A rank is 1 + the number of rows that are significantly better: all
rows face the same episodes, so every two of them are compared episode by episode.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS
from minitouch_bench.metrics.definitions import METRICS, ShownIn, ranking_metric
from minitouch_bench.metrics.intervals import (
    OVER_SEEDS,
    OVER_TASKS,
    Estimate,
    over_seeds,
    quadrature,
)
from minitouch_bench.metrics.seeds import Floats, mean_p_values
from minitouch_bench.metrics.statistics import ALPHA, MEAN, SHARE, holm, mcnemar_p
from minitouch_bench.metrics.summary import GAP_PARTS, Gap
from minitouch_bench.protocol.minitouch import NOVEL_SHAPES, PROTOCOL
from minitouch_bench.runs.run import Run

OVERALL = "overall"
MEAN_SUCCESS = "mean_success"
"""The board's own metric: the mean of the success rates of the tasks with a goal."""

RANKED_BY: Mapping[str, str] = {
    OVERALL: MEAN_SUCCESS,
    **{task: ranking_metric(task) for task in BOARD_TASKS},
}
"""What ranks the rows overall and in each task."""

BOARD_METRICS = tuple(
    name for name, metric in METRICS.items() if metric.shown_in & {ShownIn.TABLE4, ShownIn.BOARD}
)
"""What a board shows of every task that has it."""

GAP_TASKS = PROTOCOL.suite(NOVEL_SHAPES).tasks
"""The tasks that are compared on held-out and on train shapes."""

Figures = dict[str, dict[str, Estimate]]
"""A submission's estimates by task or OVERALL, then by metric."""


def score(runs: Sequence[Run]) -> Figures:
    """Return every figure of the main suite that each training seed has."""
    of_seeds = [{task.task: task.estimates for task in run.summary.tasks} for run in runs]
    figures: Figures = {OVERALL: {}}
    for task in BOARD_TASKS:
        figures[task] = {}
        for metric in BOARD_METRICS:
            estimates = [tasks[task][metric] for tasks in of_seeds if metric in tasks[task]]
            if len(estimates) == len(runs):
                possible = METRICS[metric].range_in(task)
                figures[task][metric] = over_seeds(estimates, possible)
    # The trainings of one task are independent of those of another, so their seeds are not paired.
    mean = quadrature([figures[task]["success"] for task in BOARD_GOALS])
    if len(runs) > 1:
        mean = replace(mean, count=len(runs), method=f"{OVER_SEEDS}; {OVER_TASKS}")
    figures[OVERALL][MEAN_SUCCESS] = mean
    return figures


FLOOR_SUCCESS: Mapping[str, float] = {"pushing": 0.11, "opening": 0.30, "pick-up": 0.03}
"""The highest success in Table 4 of a policy that learned nothing: random, zero or open-loop.

A training seed **learned** a task where the lower end of its success's 95 % interval lies above
this value. Without that count a mean over seeds hides that some seeds fail, and where some do,
no interval over a few seeds holds its level.
"""


def count_learned(runs: Sequence[Run]) -> dict[str, int]:
    """Return by task with a goal how many training seeds learned it, see FLOOR_SUCCESS."""
    lows: dict[str, list[float]] = {task: [] for task in BOARD_GOALS}
    for run in runs:
        for summary in run.summary.tasks:
            if summary.task in lows:
                lows[summary.task].append(summary.estimates["success"].low)
    return {task: sum(low > FLOOR_SUCCESS.get(task, 0.0) for low in lows[task]) for task in lows}


def score_gaps(runs: Sequence[Run]) -> dict[str, Gap]:
    """Return the gap of each task's ranking metric, by the runs of all training seeds."""
    gaps: dict[str, list[Gap]] = {task: [] for task in GAP_TASKS}
    for run in runs:
        for result in run.summary.generalization:
            gaps[result.task].append(result.gaps[RANKED_BY[result.task]])
    found: dict[str, Gap] = {}
    for task, of_seeds in gaps.items():
        parts = {}
        for name in GAP_PARTS if of_seeds else ():
            estimates = [getattr(gap, name) for gap in of_seeds]
            metric = METRICS[RANKED_BY[task]]
            possible = metric.range_in(task, difference=name == "difference")
            parts[name] = over_seeds(estimates, possible)
        if parts:
            found[task] = Gap(**parts)
    return found


@dataclass(frozen=True)
class Rank:
    """A row's rank: 1 + the rows that are significantly better; ``worst``: less those worse."""

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
        means = np.array([values.mean() for values in samples[task]])
        ranks[task] = ranks_of(means, _p_values(task, samples[task]))
    strata = [samples[task] for task in BOARD_GOALS]
    overall = np.mean([[values.mean() for values in rows] for rows in strata], axis=0)
    ranks[OVERALL] = ranks_of(overall, mean_p_values(strata))
    return [dict(zip(ranks, of_row, strict=True)) for of_row in zip(*ranks.values(), strict=True)]


def _p_values(task: str, rows: Sequence[Floats]) -> Floats:
    statistic = METRICS[RANKED_BY[task]].statistic
    if statistic == SHARE:
        return share_p_values(rows)
    if statistic == MEAN:
        return mean_p_values([rows])
    raise TypeError(f"rows are not ranked by {statistic}")


def ranks_of(means: Floats, p_values: Floats) -> list[Rank]:
    """Return the rank of each row, more being better.

    All pairs of the table are one family, judged together at 5 % (Holm). So A is better than B
    exactly where B is worse than A. A row that is better than another is also better than all
    that the other is better than: if both findings are true, this one is. Ranks therefore never
    contradict a finding: the better row's rank is the smaller one.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Stat.
    6 (1979).
    """
    number = len(means)
    pairs = np.triu_indices(number, 1)
    apart = np.zeros((number, number), bool)
    apart[pairs] = np.asarray(holm(p_values[pairs].tolist())) <= ALPHA
    better = (apart | apart.T) & (means[:, None] > means[None, :])
    for row in np.argsort(means):  # each row's findings are whole before those above it use them
        better[row] |= better[better[row]].any(axis=0)
    above, below = better.sum(axis=0), better.sum(axis=1)
    return [Rank(1 + int(a), number - int(b)) for a, b in zip(above, below, strict=True)]


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
        p_values[np.ix_(single, single)] = mcnemar_p(only_one, only_one.T)
    return p_values
