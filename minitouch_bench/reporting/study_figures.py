"""A study's figures: learning curves, the paper's Figures 9, 10 and 11, and other conditions."""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Final

import numpy as np
import pandas as pd

from minitouch_bench.conditions import PERTURBATIONS
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import bootstrap_seeds
from minitouch_bench.metrics.summary import HELD_OUT, TRAIN
from minitouch_bench.protocol.minitouch import GOAL_TASKS, MAIN_SUITE, NOVEL_SHAPES, PROTOCOL
from minitouch_bench.rendering.charts import (
    ROW,
    Axis,
    Band,
    Chart,
    Dot,
    Figure,
    Line,
    Mark,
    Plot,
    bands_first,
    estimate_marks,
    line_with_band,
    name_axis,
    run_legend,
    share_axis,
    short_names,
    upright_line,
    value_axis,
)
from minitouch_bench.rendering.palette import series_tone
from minitouch_bench.reporting.curve import marks_over_steps
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.long_frame import find_row, join_seeds, select

MOVEMENT: Final = "object_movement"
TOUCH: Final = "touch_share"
STEPS: Final = "episode_steps"
EXPLORING: Final = ", exploring"
"""What follows a metric's name where it is of the policy at the end of exploration."""

HEIGHT = 150
POINTS = 40
"""Of a learning curve, at most: each is a mean over 1/40 of the control steps."""

ENDS = ("value", "low", "high")


def study_figures(estimates: pd.DataFrame, curves: pd.DataFrame) -> tuple[Figure, ...]:
    """Return the figures for which there is a run.

    ``estimates``: a long frame, of which ``steps`` are those of exploration; ``curves``: method,
    seed, steps (of exploration), task, step, touch_share and success.
    """
    methods = list(dict.fromkeys([*curves["method"], *estimates["method"]]))
    main = select(estimates, suite=MAIN_SUITE, conditions="")
    figures = (
        learning_curves(curves),
        movement_and_touch(main, methods),
        exploration_lengths(main, methods),
        novel_shapes(select(estimates, suite=NOVEL_SHAPES, conditions=""), methods),
        other_conditions(select(estimates, suite=MAIN_SUITE), methods),
    )
    return tuple(figure for figure in figures if figure.plots)


def learning_curves(curves: pd.DataFrame) -> Figure:
    """Return the learning curves: what all seeds of a method show together, step by step."""
    methods = list(dict.fromkeys(curves["method"]))
    plots = []
    for task, steps, part in study_parts(curves):
        column = "success" if task in GOAL_TASKS else TOUCH
        last = float(part["step"].max())
        marks: list[Mark] = [
            mark
            for turn, method in enumerate(methods)
            for mark in _curve(select(part, method=method), column, last / POINTS, turn)
        ]
        if marks:
            label = METRICS[column].label
            y = share_axis(label)
            if steps < last:
                marks.append(upright_line(steps, y))
            chart = Chart(value_axis("Control steps", last), y, bands_first(marks), HEIGHT)
            plots.append(_plot(task, steps, f"{label} over control steps", chart))
    text = (
        "While training: success over at least 20 episodes, touch share between two rows of "
        f"progress.csv, both averaged over 1/{POINTS} of the control steps. Line: the mean "
        "over training seeds, as far as all of them have come. Band: its 95 % interval, a "
        "bootstrap over the seeds. Upright line: the end of exploration."
    )
    return Figure("curves", "Learning curves", text, tuple(plots), run_legend(methods))


def _curve(curves: pd.DataFrame, column: str, width: float, turn: int) -> Iterator[Line | Band]:
    """Yield a method's mean over seeds, a point per ``width`` control steps, and its interval."""
    known = curves.dropna(subset=[column])
    slots = np.ceil(known["step"] / width)
    by_seed = known.groupby([slots, "seed"])[column].mean().unstack().dropna()
    if len(by_seed) < 2:
        return
    steps = known.groupby(slots)["step"].max()[by_seed.index].to_numpy(float)
    if by_seed.shape[1] < 2:
        yield line_with_band(turn, steps, *[by_seed.mean(axis=1)] * len(ENDS))[0]
        return
    means = [bootstrap_seeds(values) for values in by_seed.to_numpy()]
    yield from line_with_band(turn, steps, *([getattr(one, end) for one in means] for end in ENDS))


def movement_and_touch(main: pd.DataFrame, methods: Sequence[str]) -> Figure:
    """Return Figure 9: how far the object or the door moves, against touch; a dot per training."""
    plots = []
    for task, steps, part in study_parts(main):
        suffix = EXPLORING if task in GOAL_TASKS else ""
        values = part.pivot_table("value", ["method", "seed"], "metric")
        if not {MOVEMENT + suffix, TOUCH + suffix} <= {*values.columns}:
            continue
        values = values.dropna(subset=[MOVEMENT + suffix, TOUCH + suffix])
        moved, touched = values[MOVEMENT + suffix].tolist(), values[TOUCH + suffix].tolist()
        dots = tuple(
            Dot(x, y, series_tone(methods.index(method)))
            for (method, _), x, y in zip(values.index, touched, moved, strict=True)
        )
        label = f"{METRICS[MOVEMENT].label}, {METRICS[MOVEMENT].unit_in(task)}"
        y = value_axis(label, max(moved, default=0.0))
        chart = Chart(share_axis(METRICS[TOUCH].label), y, dots, HEIGHT)
        plots.append(_plot(task, steps, "movement and touch", chart))
    text = (
        "A dot per training, of the policy at the end of exploration: touching more is not "
        "yet moving more (the paper's Figures 3 and 9)."
    )
    return Figure("movement", "Movement and touch", text, tuple(plots), run_legend(methods))


def exploration_lengths(main: pd.DataFrame, methods: Sequence[str]) -> Figure:
    """Return Figure 10: success and episode steps for each length of exploration."""
    plots = []
    for task in dict.fromkeys(main["task"]):
        lengths = select(main, task=task)["steps"]
        if lengths.nunique() < 2:
            continue
        x = value_axis("Steps of exploration", float(lengths.max()))
        charts = []
        for metric in (ranking_metric(task), *([STEPS] if task in GOAL_TASKS else [])):
            marks = marks_over_steps(join_seeds(select(main, task=task, metric=metric)), methods)
            charts.append(Chart(x, _axis(task, metric), tuple(marks), HEIGHT))
        title = task_title(task)
        plots.append(Plot(title, f"{title} by length of exploration", tuple(charts)))
    text = "Mean over training seeds and its 95 % interval (the paper's Figure 10)."
    return Figure("lengths", "Longer exploration", text, tuple(plots), run_legend(methods))


def _axis(task: str, metric: str) -> Axis:
    label = METRICS[metric].label
    if metric == STEPS:
        return value_axis(label, float(PROTOCOL.task(task).max_steps))
    return share_axis(label)


def novel_shapes(novel: pd.DataFrame, methods: Sequence[str]) -> Figure:
    """Return Figure 11: each method on train shapes (hollow) and on held-out shapes (filled)."""
    plots = []
    for task, steps, part in study_parts(novel):
        metric = ranking_metric(task)
        names = [f"{metric}, {split}" for split in (TRAIN, HELD_OUT)]
        joined = join_seeds(part[part["metric"].isin(names)])
        marks: list[Mark] = []
        for turn, method in enumerate(methods):
            for name, above in zip(names, (-0.15, 0.15), strict=True):
                estimate = find_row(joined, method=method, metric=name)
                if estimate is not None:
                    marks += estimate_marks(turn, turn + above, estimate, is_hollow=above < 0)
        chart = Chart(share_axis(METRICS[metric].label), name_axis(methods), tuple(marks), HEIGHT)
        plots.append(_plot(task, steps, "train and held-out shapes", chart))
    text = (
        "Hollow: train shapes; filled: held-out shapes; mean over training seeds and its 95 % "
        "interval (the paper's Figure 11)."
    )
    return Figure("novel-shapes", "Novel shapes", text, tuple(plots))


def other_conditions(estimates: pd.DataFrame, methods: Sequence[str]) -> Figure:
    """Return what ranks each task under the standard and the other conditions, a row each."""
    changed = estimates[estimates["conditions"] != ""]
    played = [method for method in methods if method in {*changed["method"]}]
    names = ["", *dict.fromkeys(changed["conditions"])]
    rows = name_axis(["standard", *short_names([_without_units(name) for name in names[1:]])])
    plots = []
    for task, steps, part in study_parts(estimates):
        if part["conditions"].eq("").all():
            continue
        metric = ranking_metric(task)
        joined = join_seeds(select(part, metric=metric))
        marks: list[Mark] = []
        for (row, name), (turn, method) in product(enumerate(names), enumerate(played)):
            estimate = find_row(joined, conditions=name, method=method)
            if estimate is not None:
                at = row + 0.7 * ((turn + 0.5) / len(played) - 0.5)
                marks += estimate_marks(methods.index(method), at, estimate, size=6)
        height = 1.6 * ROW * len(names)
        chart = Chart(share_axis(METRICS[metric].label), rows, tuple(marks), height)
        plots.append(_plot(task, steps, "other conditions", chart))
    text = "Mean over training seeds and its 95 % interval."
    legend = tuple(item for item in run_legend(methods) if item.text in played)
    return Figure("conditions", "Other conditions", text, tuple(plots), legend)


def _without_units(conditions: str) -> str:
    for one in PERTURBATIONS.values():
        conditions = conditions.replace(f" {one.unit}", "")
    return conditions


def _plot(task: str, steps: int, what: str, chart: Chart) -> Plot:
    caption = f"{task_title(task)}, {steps:,} steps of exploration"
    return Plot(caption, f"{what}: {caption}", (chart,))


def study_parts(frame: pd.DataFrame) -> Iterator[tuple[str, int, pd.DataFrame]]:
    """Yield each task and length of exploration with its rows, in the study's order."""
    for task, steps in dict.fromkeys(zip(frame["task"], frame["steps"], strict=True)):
        yield task, steps, select(frame, task=task, steps=steps)
