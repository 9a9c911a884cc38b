"""The figures of an experiment: learning curves, the paper's Figures 9, 10 and 11, conditions."""

import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from experiments.grid import KEY
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import student_mean
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.training_page import episode_success

COLORS = ("#0072b2", "#d55e00", "#009e73", "#aa4488", "#b87a00", "#5d2f0c", "#878d96")
MARKS = "os^vPX*"

POINTS = 40
"""Of a learning curve, at most: each is a mean over 1/40 of the control steps."""

ENOUGH_SEEDS = 5
"""With fewer the interval around a learning curve is often all of 0 to 1, and hides the others."""

SHARE = (-0.02, 1.02)
"""Ends of an axis of shares, with room for a mark at 0 and at 1."""

SAME_BYTES = {
    "backend": "svg", "svg.hashsalt": "minitouch-bench", "svg.fonttype": "none",
    "path.simplify": False, "axes.spines.top": False, "axes.spines.right": False,
    "font.size": 9, "axes.titlesize": 9, "legend.frameon": False,
}  # fmt: skip
"""Settings under which the same numbers give the same file."""

Styles = dict[str, tuple[str, str]]
"""The color and the mark of each method."""


def write_figures(
    joined: pd.DataFrame, episodes: pd.DataFrame, curves: pd.DataFrame, directory: Path
) -> None:
    """Write the figures for which there are values, as SVG files.

    Args:
        joined: A row per point with its estimate over training seeds.
        episodes: A row per episode.
        curves: A row per training and line of its ``progress.csv``.
        directory: Where the files are written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    methods = [*dict.fromkeys(joined["method"])]
    styles = {name: (COLORS[i % 7], MARKS[i % 7]) for i, name in enumerate(methods)}
    main = joined[joined["suite"] == "table4"]
    standard = main[main["conditions"] == ""]
    novel = joined[(joined["suite"] == "novel-shapes") & joined["metric"].str.contains(",")]
    others = main[main["conditions"] != ""]
    is_changed = main["task"].isin(others["task"]) & main["method"].isin(others["method"])
    ranks = main["metric"] == main["task"].map(ranking_metric)
    several = standard.groupby("task")["exploration_steps"].transform("nunique") > 1
    figures = {
        "curves": (_learning_curves, _parts(_with_success(curves))),
        "movement": (_movement, _parts(_exploring(episodes))),
        "lengths": (_lengths, _by_metric(standard[several])),
        "novel-shapes": (_novel_shapes, _by_metric(novel)),
        "conditions": (_conditions, _parts(main[ranks & is_changed])),
    }
    with mpl.rc_context(SAME_BYTES):
        for name, (draw, parts) in figures.items():
            if parts:
                _write(directory / f"{name}.svg", parts, partial(draw, styles=styles), styles)


def _parts(frame: pd.DataFrame) -> list[pd.DataFrame]:
    """Return the rows of each task and length of exploration."""
    return [part for _, part in frame.groupby(["task", "exploration_steps"], sort=False)]


def _by_metric(frame: pd.DataFrame) -> list[pd.DataFrame]:
    """Return the rows of what ranks each task, and of its episode steps."""
    metric = frame["metric"].str.split(",").str[0]  # of "success, held-out"
    is_shown = (metric == frame["task"].map(ranking_metric)) | (metric == "episode_steps")
    return [part for _, part in frame[is_shown].groupby(["task", metric], sort=False)]


def _write(
    file: Path, parts: Sequence[pd.DataFrame], draw: Callable[..., None], styles: Styles
) -> None:
    """Draw each part on axes of its own, two beside each other, above one legend."""
    columns = min(2, len(parts))
    rows = -(-len(parts) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(4.2 * columns, 2.7 * rows + 0.4), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for place, part in zip(axes.flat, parts, strict=False):
        steps = sorted({*part["exploration_steps"]})
        after = f", {steps[0]:,} steps of exploration" if len(steps) == 1 else ""
        place.set_title(task_title(part["task"].iloc[0]) + after)
        draw(place, part)
    for unused in axes.flat[len(parts) :]:
        unused.set_axis_off()
    handles = [
        plt.Line2D([], [], color=color, marker=mark, label=name)
        for name, (color, mark) in styles.items()
        if any(name in {*part["method"]} for part in parts)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(7, len(handles)))
    figure.savefig(file, metadata={"Date": None, "Creator": None})
    plt.close(figure)


def _with_success(curves: pd.DataFrame) -> pd.DataFrame:
    """Return the curves with the success over the latest training episodes, at least 20."""
    trainings = [rows for _, rows in curves.groupby(KEY, sort=False)]
    return pd.concat(rows.assign(success=episode_success(rows).to_numpy()) for rows in trainings)


def _learning_curves(axes: Axes, part: pd.DataFrame, styles: Styles) -> None:
    """Draw the mean over seeds, with its 95 % interval or, of few seeds, each seed's curve."""
    column = ranking_metric(part["task"].iloc[0])
    last, explored = part["step"].max(), part["exploration_steps"].iloc[0]
    for method, rows in part.dropna(subset=[column]).groupby("method", sort=False):
        slots = np.ceil(rows["step"] / (last / POINTS))
        by_seed = rows.groupby([slots, "training_seed"])[column].mean().unstack().dropna()
        at = rows.groupby(slots)["step"].max()[by_seed.index]
        color = styles[method][0]
        axes.plot(at, by_seed.mean(axis=1), color=color, linewidth=1.6)
        if by_seed.shape[1] < ENOUGH_SEEDS:
            axes.plot(at, by_seed, color=color, linewidth=0.6, alpha=0.6)
        else:
            means = [student_mean(values, (0.0, 1.0)) for values in by_seed.to_numpy().tolist()]
            low, high = ([getattr(one, end) for one in means] for end in ("low", "high"))
            axes.fill_between(at, low, high, color=color, alpha=0.15, linewidth=0)
    if explored < last:
        axes.axvline(explored, color="gray", linewidth=0.8)
    axes.set(ylim=SHARE, xlabel="Control steps", ylabel=METRICS[column].label)


def _exploring(episodes: pd.DataFrame) -> pd.DataFrame:
    """Return the mean touch and movement of each policy at the end of exploration."""
    role = np.where(episodes["task"].isin(GOAL_TASKS), "exploration", "final")
    is_main = (episodes["suite"] == "table4") & (episodes["conditions"] == "")
    shown = episodes[is_main & (episodes["role"] == role)]
    key = ["task", "exploration_steps", "method", "training_seed"]
    return shown.groupby(key, sort=False)[["touch_share", "object_movement"]].mean().reset_index()


def _movement(axes: Axes, part: pd.DataFrame, styles: Styles) -> None:
    """Draw a dot per training, and means over seeds (the paper's Figure 9)."""
    task, columns = part["task"].iloc[0], ("touch_share", "object_movement")
    for method, rows in part.groupby("method", sort=False):
        color, mark = styles[method]
        axes.plot(*(rows[one] for one in columns), mark, color=color, alpha=0.8, markersize=4)
        if len(rows) > 1:
            x, y = (student_mean([*rows[one]], METRICS[one].range_in(task)) for one in columns)
            axes.hlines(y.value, x.low, x.high, color=color, linewidth=0.8)
            axes.vlines(x.value, y.low, y.high, color=color, linewidth=0.8)
    unit = METRICS["object_movement"].unit_in(task)
    axes.set(xlim=SHARE, xlabel=METRICS["touch_share"].label, ylabel=f"Object movement, {unit}")


def _lengths(axes: Axes, part: pd.DataFrame, styles: Styles) -> None:
    """Draw a metric for each length of exploration (the paper's Figure 10)."""
    for method, rows in part.groupby("method", sort=False):
        ordered = rows.sort_values("exploration_steps")
        _with_intervals(axes, ordered["exploration_steps"], ordered, styles[method], line="-")
    metric = part["metric"].iloc[0]
    axes.set(xlabel="Steps of exploration", ylabel=METRICS[metric].label, xlim=(0, None))
    axes.set_ylim(_ends_of(metric))


def _ends_of(metric: str) -> tuple[float, float]:
    return SHARE if METRICS[metric].is_fraction else (0, 200)


def _novel_shapes(axes: Axes, part: pd.DataFrame, styles: Styles) -> None:
    """Draw each method on train shapes (hollow) and held-out ones (the paper's Figure 11)."""
    metric = part["metric"].iloc[0].partition(",")[0]
    methods = [*dict.fromkeys(part["method"])]
    for place, method in enumerate(methods):
        of_method = part[part["method"] == method]
        for at, split, fill in ((-0.12, "train", "none"), (0.12, "held-out", "full")):
            rows = of_method[of_method["metric"] == f"{metric}, {split}"]
            _with_intervals(axes, [place + at] * len(rows), rows, styles[method], fill=fill)
    axes.set_xticks(range(len(methods)), methods)
    axes.set(ylabel=METRICS[metric].label, xlabel="hollow: train; filled: held-out")
    axes.set_ylim(_ends_of(metric))


def _conditions(axes: Axes, part: pd.DataFrame, styles: Styles) -> None:
    """Draw what ranks the task under the standard and the other conditions."""
    names, methods = ([*dict.fromkeys(part[one])] for one in ("conditions", "method"))
    for (row, name), (turn, method) in product(enumerate(names), enumerate(methods)):
        rows = part[(part["conditions"] == name) & (part["method"] == method)]
        at = row + 0.7 * ((turn + 0.5) / len(methods) - 0.5)
        _with_intervals(axes, [at] * len(rows), rows, styles[method])
    short = [name.replace(" gray levels", "").replace(" times", "") for name in names]
    axes.set_xticks(range(len(names)), [textwrap.fill(name or "standard", 12) for name in short])
    metric = METRICS[ranking_metric(part["task"].iloc[0])]
    axes.set(ylim=SHARE, ylabel=metric.label)


def _with_intervals(
    axes: Axes, at: Any, rows: pd.DataFrame, style: tuple[str, str], *, line: str = "none",
    fill: str = "full",
) -> None:  # fmt: skip
    ends = [rows["value"] - rows["low"], rows["high"] - rows["value"]]
    axes.errorbar(
        at, rows["value"], np.clip(ends, 0, None), color=style[0], marker=style[1], markersize=4,
        linestyle=line, linewidth=1.2, fillstyle=fill,
    )  # fmt: skip
