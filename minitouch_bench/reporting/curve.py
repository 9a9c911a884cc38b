"""A learning curve over runs: what each task reaches after how many training steps."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import stream
from minitouch_bench.metrics.metric import Kind
from minitouch_bench.records import Estimate, SavedRun
from minitouch_bench.rendering.charts import (
    Chart,
    Figure,
    LegendItem,
    Line,
    Mark,
    Plot,
    run_dot,
    share_axis,
    value_axis,
)
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.palette import series_tone
from minitouch_bench.rendering.tables import Column, Row, Table, estimate_cell
from minitouch_bench.reporting.frames import csv_text, make_frame
from minitouch_bench.reporting.labels import task_title, tasks_in_order
from minitouch_bench.reporting.over_runs import ROOT, RunOrigin, over_seeds
from minitouch_bench.reporting.tables import find_estimate

STEPS = re.compile(r"[-_ ]?(?:(\d+)[-_ ]?steps?|steps?[-_ ]?(\d+))", re.IGNORECASE)
"""A number of steps in a name, as in ``rl_model_10000_steps``."""

ONE_TRAINING = "training"
HEIGHT = 130.0


@dataclass(frozen=True)
class CurvePoint:
    """The runs of one training, or of the seeds of one method, after so many steps."""

    training: str
    steps: int
    runs: tuple[SavedRun, ...]

    def estimate(self, task: str) -> Estimate | None:
        """Return what ranks a task, over training seeds where there are several."""
        metric = ranking_metric(task)
        found = [one for run in self.runs if (one := find_estimate(run, task, metric))]
        rng = stream(ROOT, "curve", self.training, str(self.steps), task)
        return over_seeds(found, rng, is_share=METRICS[metric].kind is Kind.SHARE)


def curve_points(
    runs: Sequence[SavedRun],
    origins: Sequence[RunOrigin],
    steps: Sequence[int] = (),
    names: Sequence[str] | None = None,
) -> tuple[CurvePoint, ...]:
    """Arrange runs by training and steps.

    ``steps`` and ``names`` (of the trainings, equal ones for the runs of one) are what the user
    says, one per run. Else the steps are those of the training's directory or submission, or stand
    in the policy's name, and the training is called by that name without them. Names that are all
    different tell no trainings apart: the runs are then those of one. Runs under other conditions
    than the protocol's are another training.

    Raises:
        UsageError: they are not one per run, or no steps are known of a run.
    """
    for what, given in (("--steps", steps), ("--names", names or ())):
        if given and len(given) != len(runs):
            raise UsageError(f"{what} has {len(given)} values for {len(runs)} runs")
    known = steps or [_steps(run, one) for run, one in zip(runs, origins, strict=True)]
    trainings = names or [_training(run, one) for run, one in zip(runs, origins, strict=True)]
    if names is None and len(set(trainings)) == len(runs):
        trainings = [ONE_TRAINING] * len(runs)
    points: dict[tuple[str, int], list[SavedRun]] = {}
    for training, number, run in zip(trainings, known, runs, strict=True):
        points.setdefault((printable(training), number), []).append(run)
    if len({number for _, number in points}) < 2:
        raise UsageError("a learning curve needs runs after different numbers of steps")
    order = list(dict.fromkeys(training for training, _ in points))
    return tuple(
        CurvePoint(*key, tuple(points[key]))
        for key in sorted(points, key=lambda key: (order.index(key[0]), key[1]))
    )


def _steps(run: SavedRun, origin: RunOrigin) -> int:
    if origin.steps:
        return origin.steps
    if match := STEPS.search(run.header.policy.name):
        return int(match[1] or match[2])
    raise UsageError(
        f"nothing says after how many training steps '{printable(run.name)}' was made.\n"
        "Give --steps, one number per run"
    )


def _training(run: SavedRun, origin: RunOrigin) -> str:
    name = run.header.policy.name
    training = origin.method or STEPS.sub("", name).strip("-_ ") or name
    return ", ".join((training, *run.header.played_under.in_words()))


def curve_table(points: Sequence[CurvePoint]) -> Table:
    """Lay the curve out: a row per point, a column per task."""
    tasks = _tasks(points)
    return Table(
        "Learning curve",
        ("Training", "Training steps"),
        tuple(
            Column(task_title(task), unit=METRICS[ranking_metric(task)].label.lower())
            for task in tasks
        ),
        tuple(
            Row(
                (point.training, f"{point.steps:,}"),
                tuple(estimate_cell(ranking_metric(task), point.estimate(task)) for task in tasks),
            )
            for point in points
        ),
        (
            "Brackets: 95 % interval, over training seeds where a point has several runs, else "
            "over episodes.",
        ),
    )


def curve_figure(points: Sequence[CurvePoint]) -> Figure:
    """Draw a plot per task and a line per training."""
    trainings = list(dict.fromkeys(point.training for point in points))
    legend = [LegendItem(one, series_tone(index)) for index, one in enumerate(trainings)]
    return Figure(
        "learning-curve",
        "Learning curve",
        "Success, in Playing touch share, after so many training steps. Upright: the 95 % "
        "interval, over training seeds where a point has several runs, else over episodes.",
        tuple(_plot(task, points, trainings) for task in _tasks(points)),
        tuple(legend) if len(legend) > 1 else (),
    )


def curve_csv(points: Sequence[CurvePoint]) -> str:
    """Write the numbers of the curve, one row per training, steps and task."""
    columns = ("training", "training_steps", "task", "metric", "value", "low", "high", "count",
               "method")  # fmt: skip
    rows = [
        (point.training, point.steps, task, ranking_metric(task), found.value, found.low,
         found.high, found.count, found.method)
        for point in points for task in _tasks(points)
        if (found := point.estimate(task)) is not None
    ]  # fmt: skip
    return csv_text(make_frame(columns, rows))


def _tasks(points: Sequence[CurvePoint]) -> tuple[str, ...]:
    return tasks_in_order([run for point in points for run in point.runs])


def _plot(task: str, points: Sequence[CurvePoint], trainings: Sequence[str]) -> Plot:
    label = METRICS[ranking_metric(task)].label
    marks = tuple(
        mark for index, one in enumerate(trainings) for mark in _marks(index, one, task, points)
    )
    x = value_axis("Training steps", max(point.steps for point in points))
    what = f"{task_title(task)}: {label} over training steps with 95 % intervals"
    return Plot(task_title(task), what, (Chart(x, share_axis(label), marks, HEIGHT),))


def _marks(index: int, training: str, task: str, points: Sequence[CurvePoint]) -> Iterator[Mark]:
    own = [
        (float(point.steps), found)
        for point in points
        if point.training == training and (found := point.estimate(task)) is not None
    ]
    tone = series_tone(index)
    if len(own) > 1:
        yield Line(tuple((steps, found.value) for steps, found in own), tone)
    for steps, found in own:
        yield Line(((steps, found.low), (steps, found.high)), tone, 2.2, 0.6)
        yield run_dot(index, steps, found.value, size=7)
