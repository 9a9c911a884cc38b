"""A learning curve over runs: what each task reaches after how many training steps."""

import re
from collections.abc import Sequence

import pandas as pd

from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.rendering import charts
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.tables import Column, Row, Table, estimate_cell
from minitouch_bench.reporting import long_frame
from minitouch_bench.reporting.frames import csv_text
from minitouch_bench.reporting.labels import TASKS, RunOrigin, run_names, task_title
from minitouch_bench.runs.run import Run

STEPS = re.compile(r"[-_ ]?(?:(\d+)[-_ ]?steps?|steps?[-_ ]?(\d+))", re.IGNORECASE)
"""A number of steps in a name, as in ``rl_model_10000_steps``."""

ONE_TRAINING = "training"
HEIGHT = 130.0
INTERVALS = "over training seeds where a point has several runs, otherwise over episodes."


def label_curve(
    runs: Sequence[Run],
    origins: Sequence[RunOrigin],
    steps: Sequence[int] = (),
    names: Sequence[str] | None = None,
) -> tuple[long_frame.RunLabel, ...]:
    """Say of each run which training it is of, which seed, and after how many steps.

    ``steps`` and ``names`` (of the trainings, equal names for the runs of one training) are the
    user's, one per run. Otherwise the steps are those of the training's directory or submission,
    or of the policy's name, and the training has the name of its method, or of the policy
    without steps. Such names of policies that are all different do not tell trainings apart: the
    runs are then of a single one. Runs of another suite or under other conditions are another
    training, and so is another run of the same policy.

    Raises:
        UsageError: they are not one per run, or no steps are known of a run.
    """
    for what, given in (("--steps", steps), ("--names", names or ())):
        if given and len(given) != len(runs):
            raise UsageError(f"{what} has {len(given)} values for {len(runs)} runs")
    known = steps or [_steps(*pair) for pair in zip(runs, origins, strict=True)]
    trainings = names or _trainings(runs, origins)
    if len({*known}) < 2:
        raise UsageError("a learning curve needs runs after different numbers of steps")
    seeds: dict[tuple[str, int], list[Run]] = {}
    labels = []
    for run, name, training, number in zip(runs, run_names(runs), trainings, known, strict=True):
        others = seeds.get((training, number), [])
        is_seed = not any(long_frame.repeats_policy(run, other) for other in others)
        line = training if is_seed else f"{training}, {name}"
        of_point = seeds.setdefault((line, number), [])
        labels.append(long_frame.RunLabel(printable(line), len(of_point), number))
        of_point.append(run)
    return tuple(labels)


def _steps(run: Run, origin: RunOrigin) -> int:
    if origin.steps:
        return origin.steps
    if match := STEPS.search(run.header.policy.name):
        return int(match[1] or match[2])
    raise UsageError(
        f"nothing says after how many training steps '{printable(run.name)}' was made.\n"
        "Give --steps, one number per run"
    )


def _trainings(runs: Sequence[Run], origins: Sequence[RunOrigin]) -> list[str]:
    policies = [run.header.policy.name for run in runs]
    names = [STEPS.sub("", policy).strip("-_ ") or policy for policy in policies]
    methods = [origin.method for origin in origins]
    if not any(methods) and len({*names}) == len(runs):
        names = [ONE_TRAINING] * len(runs)
    several = len({run.plan.suite for run in runs}) > 1
    return [
        ", ".join((method or name, *[run.plan.suite] * several, *run.plan.conditions.in_words()))
        for run, method, name in zip(runs, methods, names, strict=True)
    ]


def make_curve(labels: Sequence[long_frame.RunLabel], runs: Sequence[Run]) -> pd.DataFrame:
    """Return what ranks each task after each number of steps, over seeds, in the curve's order."""
    rows = (row for pair in zip(labels, runs, strict=True) for row in long_frame.frame_rows(*pair))
    # Under the user's names a point is over the runs of every suite.
    frame = long_frame.make_long_frame(rows).assign(suite="")
    joined = long_frame.join_seeds(frame[frame["metric"] == frame["task"].map(ranking_metric)])
    joined["method"] = pd.Categorical(joined["method"], [*dict.fromkeys(frame["method"])])
    joined["task"] = pd.Categorical(joined["task"], TASKS)
    return joined.sort_values(["method", "steps", "task"]).astype({"method": str, "task": str})


def curve_table(curve: pd.DataFrame) -> Table:
    """Lay the curve out: a row per training and steps, a column per task."""
    metrics = {task: ranking_metric(task) for task in _tasks(curve)}
    rows = []
    for method, steps in dict.fromkeys(zip(curve["method"], curve["steps"], strict=True)):
        point = long_frame.select(curve, method=method, steps=steps)
        cells = (
            estimate_cell(name, long_frame.find_row(point, task=task))
            for task, name in metrics.items()
        )
        rows.append(Row((method, f"{steps:,}"), tuple(cells)))
    columns = tuple(
        Column(task_title(task), unit=METRICS[name].label.lower()) for task, name in metrics.items()
    )
    notes = (f"Brackets: 95 % interval, {INTERVALS}",)
    return Table("Learning curve", ("Training", "Training steps"), columns, tuple(rows), notes)


def curve_figure(curve: pd.DataFrame) -> charts.Figure:
    """Draw a plot per task and a line per training."""
    trainings = list(dict.fromkeys(curve["method"]))
    x = charts.value_axis("Training steps", float(curve["steps"].max()))
    plots = []
    for task in _tasks(curve):
        label = METRICS[ranking_metric(task)].label
        marks = tuple(marks_over_steps(long_frame.select(curve, task=task), trainings))
        what = f"{task_title(task)}: {label} over training steps with 95 % intervals"
        chart = charts.Chart(x, charts.share_axis(label), marks, HEIGHT)
        plots.append(charts.Plot(task_title(task), what, (chart,)))
    return charts.Figure(
        "learning-curve",
        "Learning curve",
        "Success, in Playing touch share, after so many training steps. Upright: the 95 % "
        f"interval, {INTERVALS}",
        tuple(plots),
        charts.run_legend(trainings) if len(trainings) > 1 else (),
    )


def marks_over_steps(rows: pd.DataFrame, methods: Sequence[str]) -> list[charts.Mark]:
    """Return a line per method through its estimates of one metric over steps."""
    marks: list[charts.Mark] = []
    for turn, method in enumerate(methods):
        points = long_frame.select(rows, method=method).sort_values("steps")
        marks += charts.step_marks(
            turn, [*zip(map(float, points["steps"]), long_frame.estimates_in(points), strict=True)]
        )
    return marks


def curve_csv(curve: pd.DataFrame) -> str:
    """Write the numbers of the curve, one row per training, steps and task."""
    named = {"method": "training", "steps": "training_steps", "interval": "method"}
    columns = ["method", "steps", "task", "metric", *long_frame.ESTIMATE]
    return csv_text(curve[columns].rename(columns=named))


def _tasks(curve: pd.DataFrame) -> list[str]:
    present = {*curve["task"]}
    return [*(task for task in TASKS if task in present)]
