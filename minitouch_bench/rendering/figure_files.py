"""Figures as SVG and PDF files, drawn by matplotlib for print: on white, with their legend."""

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.rendering.charts import Axis, Bar, Dot, Figure, LegendItem, Line, Mark
from minitouch_bench.rendering.palette import COLORS
from minitouch_bench.rendering.svg import FONT_SIZE, WIDTH, Frame, lay_out, text_width

FORMATS = ("svg", "pdf")
UNIT = 1 / 110
"""Inches of a drawing unit: text of 7 points, three plots on the width of a page."""

MARGIN, CAPTION, LEGEND = 12.0, 20.0, 18.0
"""Drawing units around each plot, for its caption, and for a row of the legend."""

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

POINTS = FONT_SIZE * UNIT * 72


def _shade(tone: str) -> str:
    return COLORS[tone][0]


STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "minitouch-bench",
    "pdf.fonttype": 42,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": POINTS,
    "text.color": _shade("ink"),
    "text.parse_math": False,
    "axes.edgecolor": _shade("muted"),
    "axes.labelcolor": _shade("muted"),
    "axes.labelsize": POINTS,
    "axes.linewidth": 0.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "xtick.color": _shade("muted"),
    "ytick.color": _shade("muted"),
    "xtick.labelsize": POINTS,
    "ytick.labelsize": POINTS,
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
    """Place the plots in rows of two or three, below the legend."""
    columns = min(len(figure.plots), 2 if len(figure.plots) == 4 else 3)
    layouts = [lay_out(plot) for plot in figure.plots]
    legend = _legend_rows(figure.legend, columns * (WIDTH + MARGIN))
    row_height = max(layout.height for layout in layouts) + CAPTION + MARGIN
    rows = math.ceil(len(layouts) / columns)
    size = (columns * (WIDTH + MARGIN) + MARGIN, rows * row_height + legend * LEGEND + MARGIN)
    canvas = Canvas(figsize=(size[0] * UNIT, size[1] * UNIT))
    for index, (plot, layout) in enumerate(zip(figure.plots, layouts, strict=True)):
        left = MARGIN + (index % columns) * (WIDTH + MARGIN)
        top = legend * LEGEND + MARGIN + (index // columns) * row_height
        x, y = left / size[0], 1 - top / size[1]
        canvas.text(x, y, plot.caption, fontweight="bold", va="top")
        for frame in layout.frames:
            _draw_chart(_add_axes(canvas, frame, size, (left, top + CAPTION)), frame)
        x, y = (left + layout.label) / size[0], 1 - (top + CAPTION + layout.height) / size[1]
        label = plot.charts[-1].x.label
        canvas.text(x, y, label, ha="center", va="bottom", color=_shade("muted"))
    if figure.legend:
        handles = [_legend_handle(item) for item in figure.legend]
        columns_of_legend = math.ceil(len(handles) / legend)
        canvas.legend(handles=handles, loc="upper left", ncols=columns_of_legend, frameon=False)
    return canvas


def _legend_rows(items: Sequence[LegendItem], width: float) -> int:
    """Return how many rows a legend needs."""
    return math.ceil(sum(text_width(item.text) + 40 for item in items) / width)


def _add_axes(
    canvas: Canvas, frame: Frame, size: tuple[float, float], origin: tuple[float, float]
) -> Axes:
    left, bottom = origin[0] + frame.left, origin[1] + frame.bottom
    width, height = frame.right - frame.left, frame.chart.height
    return canvas.add_axes(
        (left / size[0], 1 - bottom / size[1], width / size[0], height / size[1])
    )


def _draw_chart(axes: Axes, frame: Frame) -> None:
    x, y = frame.chart.x, frame.chart.y
    for mark in frame.chart.marks:
        _draw_mark(axes, mark)
    axes.set_title(frame.chart.title, loc="left", fontsize=POINTS)
    # The frame's ends are those of the axes with the space that dots need around them.
    axes.set_xlim(*_ends(x, frame.pad / (frame.right - frame.left - 2 * frame.pad)))
    axes.set_ylim(*_ends(y, frame.pad / (frame.chart.height - 2 * frame.pad)))
    names = [tick.text if frame.is_last else "" for tick in x.ticks]
    axes.set_xticks([tick.at for tick in x.ticks], names)
    axes.set_yticks([tick.at for tick in y.ticks], [tick.text for tick in y.ticks])
    axes.set_ylabel(y.label)
    axes.grid(axis="x" if y.is_names else "y")
    for label, tick in zip(axes.get_yticklabels(), y.ticks, strict=True):
        label.set_color(_shade(tick.tone))
    if y.is_names:
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)


def _ends(axis: Axis, share: float) -> tuple[float, float]:
    """Return the ends of an axis, each moved outwards by a share of its length."""
    pad = share * (axis.high - axis.low)
    return axis.low - pad, axis.high + pad


def _draw_mark(axes: Axes, mark: Mark) -> None:
    color = _shade(mark.tone)
    match mark:
        case Line():
            across, up = zip(*mark.points, strict=True)
            width = mark.width * UNIT * 72
            axes.plot(across, up, color=color, lw=width, alpha=mark.opacity, clip_on=False)
        case Bar():
            width, height = mark.right - mark.left, mark.top - mark.bottom
            axes.bar(mark.left, height, width, mark.bottom, align="edge", color=color)
        case Dot():
            axes.plot(mark.x, mark.y, **_dot_style(mark, mark.size * UNIT * 72))


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
    return Line2D([], [], label=item.text, **_dot_style(item, POINTS))
