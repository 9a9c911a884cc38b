"""The figures of a study: learning curves, and the paper's Figures 9, 10 and 11 from our runs."""

from collections.abc import Iterator
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import trim_mean

from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import bootstrap_mean
from minitouch_bench.metrics.metric import Kind
from minitouch_bench.protocol.minitouch import GOAL_TASKS, MAIN_SUITE, NOVEL_SHAPES, PROTOCOL
from minitouch_bench.records import Estimate
from minitouch_bench.rendering.charts import (
    Chart,
    Dot,
    Figure,
    LegendItem,
    Line,
    Mark,
    Plot,
    interval_line,
    name_axis,
    run_dot,
    share_axis,
    value_axis,
)
from minitouch_bench.rendering.palette import series_tone
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.over_runs import TRIMMED, over_seeds

MOVEMENT: Final = "object_movement"
TOUCH: Final = "touch_share"
STEPS: Final = "episode_steps"
EXPLORING, GAP, HELD_OUT, TRAIN = (
    ", exploring",
    ", held-out minus train",
    ", held-out",
    ", train",
)
"""What follows a metric's name in ``estimates.csv`` where it is not that of the final policy."""

HEIGHT = 150
SEEDS_FOR_TRIMMED = 4
"""With fewer seeds their interquartile mean is their mean, or one seed."""

RESAMPLES = 1000
"""Of the bootstrap at each point of a curve."""


def study_figures(estimates: pd.DataFrame, curves: pd.DataFrame) -> Iterator[Figure]:
    """Yield the figures for which there is a run: see ``write_study`` for the two tables."""
    methods = tuple(dict.fromkeys([*curves["method"], *estimates["method"]]))
    yield from learning_curves(curves)
    main = estimates[estimates["suite"] == MAIN_SUITE]
    novel = estimates[estimates["suite"] == NOVEL_SHAPES]
    yield from movement_and_touch(main, methods)
    yield from exploration_lengths(main, methods)
    yield from novel_shapes(novel, methods)


def learning_curves(curves: pd.DataFrame) -> Iterator[Figure]:
    """Yield the learning curves: what all seeds of a method show together, step by step."""
    methods = tuple(dict.fromkeys(curves["method"]))
    plots = []
    for task, steps, own in study_parts(curves):
        column = "success" if task in GOAL_TASKS else "touch_share"
        marks = [
            line
            for turn, method in enumerate(methods)
            for line in _lines(own[own["method"] == method], column, series_tone(turn))
        ]
        if marks:
            x = value_axis("Control steps", float(own["step"].max()))
            label = "Success" if task in GOAL_TASKS else METRICS[column].label
            chart = Chart(x, share_axis(label), tuple(marks), HEIGHT)
            plots.append(_plot(task, steps, f"{label} over control steps", chart))
    if plots:
        text = (
            "While training: success over at least 20 episodes, touch share between two rows. "
            "Strong: the mean over training seeds; thin: their interquartile mean, from four seeds "
            "on; faint: the mean's 95 % interval, a bootstrap over the seeds, of few seeds too "
            "narrow; as far as all seeds have come."
        )
        yield Figure("curves", "Learning curves", text, tuple(plots), _legend(methods))


def _lines(own: pd.DataFrame, column: str, tone: str) -> Iterator[Line]:
    known = own.dropna(subset=[column])
    seeds = known.groupby("step")["seed"].transform("nunique")
    number = known["seed"].nunique()
    by_step = known[seeds == number].groupby("step")[column]
    if by_step.ngroups < 2:
        return
    shown = [(by_step.mean(), 1.6, 1.0)]
    if number >= SEEDS_FOR_TRIMMED:
        shown.append((by_step.agg(lambda values: trim_mean(values, TRIMMED)), 0.8, 1.0))
    if number >= 2:
        rng = np.random.default_rng(0)
        ends = {step: bootstrap_mean(values.to_numpy(), rng, RESAMPLES) for step, values in by_step}
        for end in ("low", "high"):
            line = pd.Series({step: getattr(found, end) for step, found in ends.items()})
            shown.append((line, 0.8, 0.35))
    for values, width, opacity in shown:
        steps = values.index.to_numpy(float).tolist()
        yield Line(tuple(zip(steps, values.tolist(), strict=True)), tone, width, opacity)


def movement_and_touch(main: pd.DataFrame, methods: tuple[str, ...]) -> Iterator[Figure]:
    """Yield Figure 9: how far the object or the door moves, against touch; a dot per training."""
    plots = []
    for task, steps, own in study_parts(main):
        suffix = EXPLORING if task in GOAL_TASKS else ""
        values = own.pivot_table("value", ["method", "seed"], "metric")
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
    if plots:
        text = (
            "A dot per training, of the policy at the end of exploration: touching more is not "
            "yet moving more (the paper's Figures 3 and 9)."
        )
        yield Figure("movement", "Movement and touch", text, tuple(plots), _legend(methods))


def exploration_lengths(main: pd.DataFrame, methods: tuple[str, ...]) -> Iterator[Figure]:
    """Yield Figure 10: success and episode steps for each length of exploration."""
    if main["exploration_steps"].nunique() < 2:
        return
    plots = []
    x = value_axis("Steps of exploration", float(main["exploration_steps"].max()))
    for task, own in main.groupby("task", sort=False):
        metrics = [ranking_metric(str(task)), *([STEPS] if task in GOAL_TASKS else [])]
        charts = []
        for metric in metrics:
            rows = own[own["metric"] == metric]
            label = METRICS[metric].label
            longest = float(PROTOCOL.task(str(task)).max_steps)
            y = value_axis(label, longest) if metric == STEPS else share_axis(label)
            marks = [
                mark
                for turn, method in enumerate(methods)
                for mark in _by_length(rows[rows["method"] == method], turn)
            ]
            charts.append(Chart(x, y, tuple(marks), HEIGHT))
        title = task_title(str(task))
        plots.append(Plot(title, f"{title} by length of exploration", tuple(charts)))
    text = "Mean over training seeds and its 95 % interval (the paper's Figure 10)."
    yield Figure("lengths", "Longer exploration", text, tuple(plots), _legend(methods))


def _by_length(own: pd.DataFrame, turn: int) -> Iterator[Mark]:
    points = []
    for steps, rows in own.groupby("exploration_steps", sort=True):
        found = study_estimate(rows)
        if found is not None:
            x = float(str(steps))
            points.append((x, found.value))
            yield Line(((x, found.low), (x, found.high)), series_tone(turn), 2.2, 0.6)
            yield run_dot(turn, x, found.value)
    if len(points) > 1:
        yield Line(tuple(points), series_tone(turn))


def novel_shapes(novel: pd.DataFrame, methods: tuple[str, ...]) -> Iterator[Figure]:
    """Yield Figure 11: each method on train shapes (hollow) and on held-out shapes (filled)."""
    plots = []
    for task, steps, own in study_parts(novel):
        metric = ranking_metric(task)
        marks: list[Mark] = []
        for turn, method in enumerate(methods):
            for split, above in ((TRAIN, -0.15), (HELD_OUT, 0.15)):
                rows = own[(own["method"] == method) & (own["metric"] == metric + split)]
                if (found := study_estimate(rows)) is not None:
                    row = turn + above
                    marks.append(interval_line(turn, row, found))
                    marks.append(run_dot(turn, found.value, row, is_hollow=split == TRAIN))
        chart = Chart(share_axis(METRICS[metric].label), name_axis(methods), tuple(marks), HEIGHT)
        plots.append(_plot(task, steps, "train and held-out shapes", chart))
    if plots:
        text = (
            "Hollow: 200 train shapes; filled: the 200 held-out shapes; mean over training seeds "
            "and its 95 % interval (the paper's Figure 11)."
        )
        yield Figure("novel-shapes", "Novel shapes", text, tuple(plots))


def _plot(task: str, steps: int, what: str, chart: Chart) -> Plot:
    caption = f"{task_title(task)}, {steps:,} steps of exploration"
    return Plot(caption, f"{what}: {caption}", (chart,))


def _legend(methods: tuple[str, ...]) -> tuple[LegendItem, ...]:
    return tuple(LegendItem(one, series_tone(turn)) for turn, one in enumerate(methods))


def study_estimate(own: pd.DataFrame) -> Estimate | None:
    """Estimate a metric from the rows that a study has of it, one per training seed."""
    if own.empty:
        return None
    columns = (own[name].tolist() for name in ("value", "low", "high", "episodes"))
    estimates = [
        Estimate(value, low, high, int(episodes), "over episodes")
        for value, low, high, episodes in zip(*columns, strict=True)
    ]
    metric = str(own["metric"].iloc[0])
    is_share = METRICS[metric.split(",", 1)[0]].kind is Kind.SHARE and not metric.endswith(GAP)
    return over_seeds(estimates, np.random.default_rng(0), is_share=is_share)


def study_parts(frame: pd.DataFrame) -> Iterator[tuple[str, int, pd.DataFrame]]:
    """Yield each task and length of exploration with its rows, in the study's order."""
    keys = zip(frame["task"].tolist(), frame["exploration_steps"].tolist(), strict=True)
    for task, steps in dict.fromkeys(keys):
        chosen = (frame["task"] == task) & (frame["exploration_steps"] == steps)
        yield task, steps, frame[chosen]
