"""A training's ``report.html``: its learning curves and settings on one page."""

import io
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from minitouch_bench.files import PROGRESS_FILE, read_file
from minitouch_bench.reporting import charts
from minitouch_bench.reporting.charts import Chart, Mark, Plot
from minitouch_bench.reporting.figures import FREE_AIR
from minitouch_bench.reporting.labels import listed, task_title
from minitouch_bench.reporting.pages import TEMPLATES, render_page

EPISODES = 20
"""Training episodes that a point of the success curve is the share of, at least."""
HEIGHT = 112
TRAINING, EVALUATION = charts.series_tone(0), charts.series_tone(1)

FIGURES = (
    (
        "What it does",
        f"Success over at least {EPISODES} training episodes, touch share over the control "
        "steps between two rows; evaluation on episodes of their own. Force: mean over the control "
        "steps of the larger of the two fingers' forces; a finger in free air reads about "
        f"{FREE_AIR:g} N. The upright line is where the task's reward takes over.",
        {"success": "Success", "touch_share": "Touch share", "force": "Force, N"},
    ),
    (
        "What it is paid",
        "Means between two rows of progress.csv.",
        {"intrinsic_reward": "Intrinsic reward", "task_reward": "Task reward per step"},
    ),
    (
        "How it learns",
        "Means over the gradient steps between rows.",
        {
            "curiosity_loss": "Curiosity loss",
            "critic_loss": "Critic loss",
            "value": "Value",
            "entropy": "Entropy, nats",
            "temperature": "Temperature",
        },
    ),
)
"""Title and text of each figure, and the captions of the columns of ``progress.csv`` in it."""


def training_page(directory: Path) -> str:
    """Return the page of a training directory, from ``progress.csv`` and ``config.toml``."""
    rows = pd.read_csv(io.BytesIO(read_file(directory / PROGRESS_FILE)))
    rows = rows.replace([math.inf, -math.inf], math.nan)  # losses of a training that diverges
    last = rows.iloc[-1].to_dict()
    rows["success"] = episode_success(rows)
    both = (charts.LegendItem("training", TRAINING), charts.LegendItem("evaluation", EVALUATION))
    is_evaluated = rows.filter(like="evaluation_").notna().any(axis=None)
    figures = []
    for number, (title, text, columns) in enumerate(FIGURES):
        plots = tuple(plot for item in columns.items() if (plot := _plot(rows, *item)))
        legend = both if is_evaluated and number == 0 else ()
        if plots:
            figures.append(charts.Figure(f"figure-{number}", title, text, plots, legend))
    settings = read_file(directory / "config.toml").decode()
    return render_page(
        TEMPLATES / "training.html.j2",
        scripts=("theme.js",),
        name=directory.resolve().name,
        title=_title(tomllib.loads(settings)),
        last=last,
        figures=figures,
        settings=settings,
    )


def _title(settings: Mapping[str, Any]) -> str:
    """Say what was trained: task, method and seed, and the senses that it does without."""
    words = [task_title(settings["task"]), settings["method"], f"seed {settings['seed']}"]
    explored, learned = (
        settings.get(phase, {}).get("without", ()) for phase in ("exploration", "task_phase")
    )
    if explored:
        words.append(f"without {listed(explored)}")
    if more := [sense for sense in learned if sense not in explored]:
        words.append(f"task phase without {listed(more)}")
    return ", ".join(words)


def _plot(rows: pd.DataFrame, column: str, caption: str) -> Plot | None:
    """Draw a column, and where the exploration ends; None where it has no value."""
    last = int(rows["step"].iloc[-1])
    exploration = rows.loc[rows["phase"] == "exploration", "step"]
    marks: list[Mark] = []
    for name, tone in ((column, TRAINING), (f"evaluation_{column}", EVALUATION)):
        points = rows.reindex(columns=["step", name]).dropna().astype(float)
        if len(points):
            marks.append(charts.Line(tuple(points.itertuples(index=False, name=None)), tone))
    if not marks:
        return None
    values = [0.0, *rows[column].dropna()]
    is_share = f"evaluation_{column}" in rows
    axis = charts.value_axis(caption, 1.0 if is_share else max(values), lowest=min(values))
    if 0 < len(exploration) < len(rows):
        end = float(exploration.iloc[-1])
        marks.append(charts.Line(((end, axis.low), (end, axis.high)), "muted", 0.8))
    chart = Chart(charts.value_axis("Control steps", last), axis, tuple(marks), HEIGHT)
    return Plot(caption, f"{caption} over {last} control steps", (chart,))


def episode_success(rows: pd.DataFrame) -> "pd.Series[float]":
    """Return the success share over the latest episodes, at least ``EPISODES`` of them."""
    won = np.cumsum([0.0, *(rows["success"].fillna(0.0) * rows["episodes"])])
    done = np.cumsum([0, *rows["episodes"]])
    first = np.searchsorted(done, done - EPISODES, side="right") - 1  # -1: too few before
    counts = np.where(first >= 0, done - done[first], math.nan)
    return pd.Series(((won - won[first]) / counts)[1:])
