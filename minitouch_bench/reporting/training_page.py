"""A training's ``report.html``: its learning curves and settings on one page."""

import io
import math
from collections.abc import Iterator, Mapping
from pathlib import Path

import pandas as pd

from minitouch_bench.files import PROGRESS_FILE, read_file
from minitouch_bench.reporting import charts
from minitouch_bench.reporting.charts import series_tone
from minitouch_bench.reporting.pages import render_page

TEMPLATE = Path(__file__).parent / "templates" / "training.html.j2"
EPISODES = 20
"""Training episodes that a point of the success curve is the share of, at least."""
HEIGHT = 112
TRAINING, EVALUATION = series_tone(0), series_tone(1)

FIGURES = (
    (
        "shares",
        "What it does",
        f"Success over at least {EPISODES} training episodes, touch share over the control "
        "steps between two rows; evaluation on episodes of their own. The upright line is "
        "where the task's reward takes over.",
        {"success": "Success", "touch_share": "Touch share"},
    ),
    (
        "rewards",
        "What it is paid",
        "Means between two rows of progress.csv.",
        {"intrinsic_reward": "Intrinsic reward", "task_reward": "Task reward per step"},
    ),
    (
        "inside",
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
"""Key, title and text of each figure, and the captions of its columns of ``progress.csv``."""


def training_page(directory: Path) -> str:
    """Return the page of a training directory, from ``progress.csv`` and ``config.toml``."""
    rows = pd.read_csv(io.BytesIO(read_file(directory / PROGRESS_FILE)))
    rows = rows.replace([math.inf, -math.inf], math.nan)  # losses of a training that diverges
    settings = read_file(directory / "config.toml").decode()
    return render_page(
        TEMPLATE,
        name=directory.resolve().name,
        last=rows.iloc[-1].to_dict(),
        figures=_figures(rows),
        settings=settings,
    )


def _figures(rows: pd.DataFrame) -> tuple[charts.Figure, ...]:
    rows = rows.assign(success=episode_success(rows))
    both = (charts.LegendItem("training", TRAINING), charts.LegendItem("evaluation", EVALUATION))
    figures = (
        charts.Figure(
            key, title, text, tuple(_plots(rows, columns)), both if key == "shares" else ()
        )
        for key, title, text, columns in FIGURES
    )
    return tuple(figure for figure in figures if figure.plots)


def _plots(rows: pd.DataFrame, columns: Mapping[str, str]) -> Iterator[charts.Plot]:
    """Draw the columns that have values, and where the exploration ends."""
    last = int(rows["step"].iloc[-1])
    exploration = rows.loc[rows["phase"] == "exploration", "step"]
    for column, caption in columns.items():
        is_share = f"evaluation_{column}" in rows
        names = (column, f"evaluation_{column}") if is_share else (column,)
        values = [0.0, *rows[column].dropna().tolist()]
        axis = (
            charts.share_axis(caption)
            if is_share
            else charts.value_axis(caption, max(values), lowest=min(values))
        )
        marks: list[charts.Mark] = []
        for name, tone in zip(names, (TRAINING, EVALUATION), strict=False):
            points = rows[["step", name]].dropna().astype(float)
            if len(points):
                marks.append(charts.Line(tuple(points.itertuples(index=False, name=None)), tone))
        if not marks:
            continue
        if 0 < len(exploration) < len(rows):
            marks.append(charts.upright_line(float(exploration.iloc[-1]), axis))
        chart = charts.Chart(charts.value_axis("Control steps", last), axis, tuple(marks), HEIGHT)
        yield charts.Plot(caption, f"{caption} over {last} control steps", (chart,))


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
