"""The figures of a board's row: those in ``run.json``, over training seeds where there are several.

Nothing is estimated over episodes here. The figures of one training seed are its run's.
"""

from collections.abc import Mapping, Sequence

from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import over_seeds, pooled_share, quadrature
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
    mean = _mean_success([[tasks[task]["success"] for task in BOARD_GOALS] for tasks in of_seeds])
    figures: Figures = {OVERALL: {MEAN_SUCCESS: mean}}
    for task in BOARD_TASKS:
        figures[task] = {}
        for metric in BOARD_METRICS:
            estimates = [tasks[task][metric] for tasks in of_seeds if metric in tasks[task]]
            figure = over_seeds(estimates, task, metric)
            if figure is not None and len(estimates) == len(runs):
                figures[task][metric] = figure
    return figures


def _mean_success(of_seeds: Sequence[Sequence[Estimate]]) -> Estimate:
    """Estimate the mean success over the tasks, given by training seed and task."""
    pooled = quadrature([pooled_share(shares) for shares in zip(*of_seeds, strict=True)])
    means = [quadrature(shares) for shares in of_seeds]
    mean = over_seeds(means, OVERALL, MEAN_SUCCESS, over_episodes=pooled)
    assert mean is not None  # a submission has a training seed
    return mean


def score_gaps(runs: Sequence[Run]) -> dict[str, Gap]:
    """Return the gap of each task's ranking metric, by the runs of all training seeds."""
    gaps: dict[str, list[Gap]] = {task: [] for task in GAP_TASKS}
    for run in runs:
        for result in run.summary.generalization:
            gaps[result.task].append(result.gaps[RANKED_BY[result.task]])
    return {task: _gap(task, of_seeds) for task, of_seeds in gaps.items() if of_seeds}


def _gap(task: str, gaps: Sequence[Gap]) -> Gap:
    parts = {}
    for name, title in GAP_PARTS.items():
        estimates = [getattr(gap, name) for gap in gaps]
        part = over_seeds(estimates, task, f"{RANKED_BY[task]}, {title}")
        assert part is not None  # there is a gap
        parts[name] = part
    return Gap(**parts)
