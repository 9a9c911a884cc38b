"""The figures of a board's row: those in ``run.json``, over training seeds where there are several.

Nothing is estimated over episodes here. The figures of one training seed are its run's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import OVER_SEEDS, OVER_TASKS, over_seeds, quadrature
from minitouch_bench.metrics.metric import ShownIn
from minitouch_bench.metrics.summary import GAP_PARTS
from minitouch_bench.protocol.minitouch import NOVEL_SHAPES, PROTOCOL
from minitouch_bench.records import Estimate, Gap
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
    return {task: _gap(task, of_seeds) for task, of_seeds in gaps.items() if of_seeds}


def _gap(task: str, gaps: Sequence[Gap]) -> Gap:
    metric = METRICS[RANKED_BY[task]]
    parts = {
        name: over_seeds(
            [getattr(gap, name) for gap in gaps],
            metric.range_in(task, difference=name == "difference"),
        )
        for name in GAP_PARTS
    }
    return Gap(**parts)
