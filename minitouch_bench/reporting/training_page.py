"""A training's ``report.html``: its learning curves and settings on one page."""

import io
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from minitouch_bench.files import PROGRESS_FILE, read_file
from minitouch_bench.rendering.charts import (
    Axis,
    Chart,
    Figure,
    LegendItem,
    Line,
    Plot,
    share_axis,
    upright_line,
    value_axis,
)
from minitouch_bench.rendering.pages import render_page
from minitouch_bench.rendering.palette import series_tone

TEMPLATE = Path(__file__).parent / "templates" / "training.html.j2"
EPISODES = 20
"""Training episodes that a point of the success curve is the share of, at least."""
HEIGHT = 112
TRAINING, EVALUATION = series_tone(0), series_tone(1)


def training_page(directory: Path) -> str:
    """Return the page of a training directory, from ``progress.csv`` and ``config.toml``."""
    rows = pd.read_csv(io.BytesIO(read_file(directory / PROGRESS_FILE)))
    settings = read_file(directory / "config.toml").decode()
    return render_page(
        TEMPLATE,
        name=directory.resolve().name,
        last=rows.iloc[-1].to_dict(),
        figures=_figures(rows),
        settings=settings,
    )


def _figures(rows: pd.DataFrame) -> tuple[Figure, ...]:
    both = (LegendItem("training", TRAINING), LegendItem("evaluation", EVALUATION))
    shares = (
        _share_plot(rows, "Success", episode_success(rows), "evaluation_success"),
        _share_plot(rows, "Touch share", rows["touch_share"], "evaluation_touch_share"),
    )
    rewards = (
        _value_plot(rows, "Intrinsic reward", "intrinsic_reward"),
        _value_plot(rows, "Task reward per step", "task_reward"),
    )
    inside = tuple(
        _value_plot(rows, caption, column)
        for caption, column in (
            ("Curiosity loss", "curiosity_loss"),
            ("Critic loss", "critic_loss"),
            ("Value", "value"),
            ("Entropy, nats", "entropy"),
            ("Temperature", "temperature"),
        )
    )
    all_figures = (
        Figure(
            "shares",
            "What it does",
            f"Success over at least {EPISODES} training episodes, touch share over the control "
            "steps between two rows; evaluation on episodes of their own. The upright line is "
            "where the task's reward takes over.",
            shares,
            both,
        ),
        Figure("rewards", "What it is paid", "Means between two rows of progress.csv.", rewards),
        Figure("inside", "How it learns", "Means over the gradient steps between rows.", inside),
    )
    drawn = (
        replace(figure, plots=tuple(plot for plot in figure.plots if plot.charts))
        for figure in all_figures
    )
    return tuple(figure for figure in drawn if figure.plots)


def episode_success(rows: pd.DataFrame) -> "pd.Series[float]":
    """Return the success share over the latest episodes, at least ``EPISODES`` of them."""
    won = [0.0, *(rows["success"].fillna(0.0) * rows["episodes"]).cumsum()]
    done = [0, *rows["episodes"].cumsum()]
    shares, first = [], 0
    for last in range(1, len(done)):
        while done[last] - done[first + 1] >= EPISODES:
            first += 1
        count = done[last] - done[first]
        shares.append((won[last] - won[first]) / count if count >= EPISODES else math.nan)
    return pd.Series(shares, dtype=float)


def _share_plot(
    rows: pd.DataFrame, caption: str, training: "pd.Series[float]", evaluation: str
) -> Plot:
    lines = [
        _line(rows["step"], training, TRAINING),
        _line(rows["step"], rows[evaluation], EVALUATION),
    ]
    return _plot(rows, caption, share_axis(caption), lines)


def _value_plot(rows: pd.DataFrame, caption: str, column: str) -> Plot:
    values = [0.0, *rows[column].dropna().tolist()]
    axis = value_axis(caption, max(values), lowest=min(values))
    return _plot(rows, caption, axis, [_line(rows["step"], rows[column], TRAINING)])


def _plot(rows: pd.DataFrame, caption: str, axis: Axis, lines: Sequence[Line | None]) -> Plot:
    marks = [line for line in lines if line is not None]
    if not marks:
        return Plot(caption, f"{caption}: nothing recorded", ())
    last = int(rows["step"].iloc[-1])
    exploration = rows.loc[rows["phase"] == "exploration", "step"]
    if 0 < len(exploration) < len(rows):
        marks.append(upright_line(float(exploration.iloc[-1]), axis))
    x = value_axis("Control steps", last)
    return Plot(
        caption, f"{caption} over {last} control steps", (Chart(x, axis, tuple(marks), HEIGHT),)
    )


def _line(steps: "pd.Series[int]", values: "pd.Series[float]", tone: str) -> Line | None:
    """Return the line through the values that there are, None where there are none."""
    known = values.notna().to_numpy()
    points = zip(steps[known].tolist(), values[known].tolist(), strict=True)
    known_points = tuple((float(step), float(value)) for step, value in points)
    return Line(known_points, tone) if known_points else None
