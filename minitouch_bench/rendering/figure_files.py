"""Figures as SVG and PDF files, drawn by matplotlib for print: on white, with their legend."""

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.figure import SubFigure
from matplotlib.lines import Line2D

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.rendering.charts import Bar, Chart, Dot, Figure, LegendItem, Line, Plot
from minitouch_bench.rendering.palette import COLORS

FORMATS = ("svg", "pdf")
COLUMNS = 4
WIDTH = 7.0
"""Width of a file, inches: a page's text across two columns."""

UNIT = 1 / 92
"""Inches of a chart's drawing unit."""

CODES = {
    "circle": "o",
    "square": "s",
    "up": "^",
    "down": "v",
    "plus": "P",
    "cross": "X",
    "diamond": "D",
}
"""matplotlib's names of the marks."""


def _shade(tone: str) -> str:
    return COLORS[tone][0]


STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "minitouch-bench",
    "pdf.fonttype": 42,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 7.0,
    "text.color": _shade("ink"),
    "text.parse_math": False,
    "axes.edgecolor": _shade("muted"),
    "axes.labelcolor": _shade("muted"),
    "axes.labelsize": 6.5,
    "axes.linewidth": 0.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "xtick.color": _shade("muted"),
    "ytick.color": _shade("muted"),
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "grid.color": _shade("rule"),
    "grid.linewidth": 0.5,
}


def write_figures(figures: Sequence[Figure], directory: Path) -> list[Path]:
    """Write each figure as ``KEY.svg`` and ``KEY.pdf``; equal figures give equal bytes.

    Raises:
        RunDirectoryError: a file cannot be written.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        return [path for figure in figures for path in _write(figure, directory)]
    except OSError as error:
        raise RunDirectoryError(f"{directory} cannot be written: {error.strerror}") from error


def _write(figure: Figure, directory: Path) -> list[Path]:
    paths = [directory / f"{figure.key}.{form}" for form in FORMATS]
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # A name may hold any character; a reader's font draws it, not matplotlib's.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        canvas = _draw(figure)
        for path in paths:
            dates = {"Date": None} if path.suffix == ".svg" else {"CreationDate": None}
            canvas.savefig(path, metadata={"Creator": "minitouch-bench", **dates})
    return paths


def _draw(figure: Figure) -> Canvas:
    columns = min(COLUMNS, len(figure.plots))
    rows = math.ceil(len(figure.plots) / columns)
    height = rows * max(map(_plot_height, figure.plots)) + (0.25 if figure.legend else 0.0)
    canvas = Canvas(figsize=(WIDTH * columns / COLUMNS, height), layout="constrained")
    parts = canvas.subfigures(rows, columns, squeeze=False)
    for part, plot in zip(parts.flat, figure.plots, strict=False):
        _draw_plot(part, plot)
    if figure.legend:
        handles = [_legend_handle(item) for item in figure.legend]
        canvas.legend(handles=handles, loc="outside upper left", ncols=columns, frameon=False)
    return canvas


def _plot_height(plot: Plot) -> float:
    """Return the height of a plot with its caption and numbers, inches."""
    return 0.55 + sum(chart.height * UNIT + (0.15 if chart.title else 0) for chart in plot.charts)


def _draw_plot(part: SubFigure, plot: Plot) -> None:
    part.suptitle(plot.caption, x=0.02, ha="left", fontweight="bold")
    heights = [chart.height for chart in plot.charts]
    grid = part.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
    for axes, chart in zip(grid[:, 0], plot.charts, strict=True):
        _draw_chart(axes, chart)
    grid[-1, 0].set_xlabel(plot.charts[-1].x.label)


def _draw_chart(axes: Axes, chart: Chart) -> None:
    x, y = chart.x, chart.y
    for mark in chart.marks:
        _draw_mark(axes, mark)
    axes.set_title(chart.title, loc="left", fontsize=6.5)
    axes.set_xlim(x.low, x.high)
    axes.set_ylim(y.low, y.high)
    axes.set_xticks([tick.at for tick in x.ticks], [tick.text for tick in x.ticks])
    axes.set_yticks([tick.at for tick in y.ticks], [tick.text for tick in y.ticks])
    axes.set_ylabel(y.label)
    axes.grid(axis="x" if y.is_names else "y")
    for label, tick in zip(axes.get_yticklabels(), y.ticks, strict=True):
        label.set_color(_shade(tick.tone))
    if y.is_names:
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)


def _draw_mark(axes: Axes, mark: Line | Bar | Dot) -> None:
    color = _shade(mark.tone)
    match mark:
        case Line():
            across, up = zip(*mark.points, strict=True)
            width = 0.6 * mark.width
            axes.plot(across, up, color=color, lw=width, alpha=mark.opacity, clip_on=False)
        case Bar():
            width, height = mark.right - mark.left, mark.top - mark.bottom
            axes.bar(mark.left, height, width, mark.bottom, align="edge", color=color)
        case Dot():
            axes.plot(mark.x, mark.y, **_dot_style(mark, 0.55 * mark.size))


def _dot_style(mark: Dot | LegendItem, size: float) -> dict[str, Any]:
    """Return how matplotlib draws a dot; one at the end of an axis is drawn whole."""
    color = _shade(mark.tone)
    return {
        "marker": CODES[mark.shape],
        "ls": "",
        "ms": size,
        "mec": color,
        "mfc": "none" if mark.is_hollow else color,
        "mew": 0.9 if mark.is_hollow else 0.0,
        "clip_on": False,
    }


def _legend_handle(item: LegendItem) -> Line2D:
    return Line2D([], [], label=item.text, **_dot_style(item, 5.0))
