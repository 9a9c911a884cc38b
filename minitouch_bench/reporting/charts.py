"""Charts as data, in the units of their axes, and drawn as SVG.

Drawn directly, by measurement: the 19 plots of a report on novel shapes take 5 ms and 50 kB, with
matplotlib 1 s, 0.5 s to import it, and 213 kB. The drawings carry classes and attributes, no
styles, so that a page's policy can forbid every style but its own, and they take the page's colors,
light or dark, and its font. A drawing is made of paths of straight lines, circles and texts alone.
"""

import html
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from markupsafe import Markup
from rich.cells import cell_len

from minitouch_bench.metrics.intervals import Estimate

RUN_COLORS = 7
"""Colors of runs in ``page.css``, which has the shades of every color that a mark can name."""


def series_tone(index: int) -> str:
    """Return the color of the run at this position; the eighth has that of the first."""
    return f"series-{index % RUN_COLORS}"


THOUSANDS_FROM = 10_000
"""Highest value from which an axis counts in thousands, as "2.5k"."""

ROW = 23.0
"""Height of a row of dots, drawing units."""


@dataclass(frozen=True)
class Line:
    """A line through points, or the only one as a dot; ``width`` in drawing units."""

    points: tuple[tuple[float, float], ...]
    tone: str
    width: float = 1.6
    opacity: float = 1.0


@dataclass(frozen=True)
class Band:
    """The area inside a line through points."""

    points: tuple[tuple[float, float], ...]
    tone: str
    opacity: float = 1.0


@dataclass(frozen=True)
class Spots:
    """Round dots of one color, drawn as one path, so that a page of thousands stays small.

    ``size``: their height, drawing units. ``episodes``: the index of each one's episode, () where
    they show none.
    """

    points: tuple[tuple[float, float], ...]
    tone: str
    size: float
    episodes: tuple[int, ...] = ()


@dataclass(frozen=True)
class Blocks:
    """Rectangles of one color, drawn as one path: left, bottom, right and top of each."""

    boxes: tuple[tuple[float, float, float, float], ...]
    tone: str


Mark = Line | Band | Spots | Blocks


@dataclass(frozen=True)
class Tick:
    """A labeled value of an axis."""

    at: float
    text: str


@dataclass(frozen=True)
class Axis:
    """A linear axis from ``low``, at the left or below, to ``high``.

    ``is_names``: its ticks name rows, which need no line and no rules.
    """

    label: str
    low: float
    high: float
    ticks: tuple[Tick, ...]
    is_names: bool = False

    def place(self, value: float, start: float, end: float) -> float:
        """Return where a value is between the two ends of a drawn axis."""
        return start + (value - self.low) / (self.high - self.low) * (end - start)


@dataclass(frozen=True)
class Chart:
    """One pair of axes with marks.

    ``height`` of the area between them, drawing units; None: both axes have one scale.
    """

    x: Axis
    y: Axis
    marks: tuple[Mark, ...]
    height: float | None
    title: str = ""


@dataclass(frozen=True)
class Plot:
    """Charts below each other on one x axis, one caption and one description.

    ``note`` is printed below. ``source``: whose episodes its spots are, the number of a run in the
    page's browser and what precedes the index in an episode's key, as "0 pushing".
    """

    caption: str
    description: str
    charts: tuple[Chart, ...]
    note: str = ""
    source: str = ""


@dataclass(frozen=True)
class LegendItem:
    """What a color stands for."""

    text: str
    tone: str
    title: str = ""


@dataclass(frozen=True)
class Figure:
    """Plots under one heading; ``key`` names its file and its place on a page."""

    key: str
    title: str
    text: str
    plots: tuple[Plot, ...]
    legend: tuple[LegendItem, ...] = ()


# Axes


def value_axis(label: str, highest: float, intervals: int = 4, lowest: float = 0.0) -> Axis:
    """Return an axis of round numbers from ``lowest`` or below to ``highest`` or above."""
    step = _round_step((highest - lowest) / intervals)
    first = math.floor(lowest / step + 1e-9)
    last = max(first + 1, math.ceil(highest / step - 1e-9))
    size, unit = (1000, "k") if step * last >= THOUSANDS_FROM else (1, "")
    ticks = tuple(
        Tick(step * i, f"{step * i / size:.12g}{unit if i else ''}") for i in range(first, last + 1)
    )
    return Axis(label, step * first, step * last, ticks)


def even_axis(label: str, start: float, end: float, step: int) -> Axis:
    """Return an axis from ``start`` to ``end`` with a tick at each multiple of ``step``."""
    low, high = sorted((start, end))
    ticks = range(step * math.ceil(low / step), math.floor(high) + 1, step)
    return Axis(label, start, end, tuple(Tick(at, str(at)) for at in ticks))


def name_axis(names: Sequence[str]) -> Axis:
    """Return an axis that names rows from the top down."""
    ticks = tuple(Tick(row, name) for row, name in enumerate(names))
    return Axis("", len(ticks) - 0.5, -0.5, ticks, is_names=True)


def _round_step(least: float) -> float:
    """Return the smallest of 1, 2, 2.5 or 5 times a power of ten that is no smaller."""
    if least <= 0 or not math.isfinite(least):
        return 1.0
    size = 10.0 ** math.floor(math.log10(least))
    return next(step * size for step in (1, 2, 2.5, 5, 10) if step * size >= least * (1 - 1e-9))


# Drawing

WIDTH = 260
"""Drawing units across a plot; a unit is about a pixel."""

CHARACTER = 6.4
"""Width of an average character of the drawing's font, 11 units high."""

LONGEST_TITLE = 40
"""Characters of a chart's title, which names a run."""

PAD = 7
"""Space around dots, so that one at the end of an axis is drawn whole."""

POINT = 5.0
"""Size of a line's only point."""

TITLE, NUMBERS, LABEL, GAP = 18.0, 18.0, 18.0, 10.0
"""Heights: a chart's title, the numbers and the label below the last chart, between charts."""


@dataclass(frozen=True)
class PlotArea:
    """The area between a chart's axes, y downwards, ``pad`` wider than they are."""

    chart: Chart
    left: float
    right: float
    top: float
    pad: float
    is_last: bool

    @property
    def bottom(self) -> float:
        """The height of the x axis."""
        if self.chart.height is not None:
            return self.top + self.chart.height
        x, y = self.chart.x, self.chart.y
        scale = (self.right - self.left - 2 * self.pad) / abs(x.high - x.low)
        return self.top + scale * abs(y.high - y.low) + 2 * self.pad

    def x(self, value: float) -> float:
        """Return where a value of the x axis is drawn."""
        return self.chart.x.place(value, self.left + self.pad, self.right - self.pad)

    def y(self, value: float) -> float:
        """Return where a value of the y axis is drawn."""
        return self.chart.y.place(value, self.bottom - self.pad, self.top + self.pad)


def text_width(text: str) -> float:
    """Estimate the width of a text."""
    return CHARACTER * cell_len(text)


def _shortened(title: str) -> str:
    """Leave out the middle of a title that is wider than a plot."""
    fits = len(title) <= LONGEST_TITLE
    return title if fits else f"{title[: LONGEST_TITLE // 2]}…{title[1 - LONGEST_TITLE // 2 :]}"


def _left_margin(axis: Axis) -> float:
    widest = max(text_width(tick.text) for tick in axis.ticks)
    return widest + 8 + (14 if axis.label else 0)


def _right_margin(chart: Chart) -> float:
    """Leave room for half of the last number."""
    return max(2.0, text_width(chart.x.ticks[-1].text) / 2 - PAD)


def draw_plot(plot: Plot) -> Markup:
    """Draw the charts of a plot below each other, on one left edge and one x axis."""
    left = max(_left_margin(chart.y) for chart in plot.charts)
    right = WIDTH - max(map(_right_margin, plot.charts))
    parts: list[str] = []
    bottom = 4.0 - GAP
    for chart in plot.charts:
        top = bottom + GAP + (TITLE if chart.title else 0.0)
        pad = PAD if chart.y.is_names else 0.0
        area = PlotArea(chart, left, right, top, pad, chart is plot.charts[-1])
        bottom = area.bottom
        if chart.title:
            parts.append(_text(0, top - 8, _shortened(chart.title), "ink"))
        parts += _grid(area)
        parts += (_mark(area, mark) for mark in chart.marks)
    height = bottom + NUMBERS
    if label := plot.charts[-1].x.label:
        half = text_width(label) / 2
        center = min(max((left + right) / 2, half), WIDTH - half)
        parts.append(_text(center, bottom + 31, label, "middle"))
        height += LABEL
    source = f' data-source="{html.escape(plot.source)}"' if plot.source else ""
    return Markup(
        f'<svg class="drawing" viewBox="0 0 {WIDTH} {_n(height)}"{source} '
        f'role="img" aria-label="{html.escape(plot.description)}">{"".join(parts)}</svg>'
    )


def draw_gauge(share: Estimate, mark: str) -> Markup:
    """Draw a share on a scale as wide as its place, with a ``mark`` for comparison if not ""."""
    value, low, high = (f"{100 * end:.4g}" for end in (share.value, share.low, share.high))
    compared = f'<path class="mark" d="M{100 * float(mark):.4g} -2V8"/>' if mark else ""
    return Markup(
        '<svg class="gauge" viewBox="0 0 100 6" preserveAspectRatio="none" aria-hidden="true">'
        f'<path class="track" d="M0 3H100"/><path class="interval" d="M{low} 3H{high}"/>{compared}'
        f'<path class="ring" d="M{value} 3h0"/><path class="value" d="M{value} 3h0"/></svg>'
    )


def _grid(frame: PlotArea) -> Iterator[str]:
    chart = frame.chart
    for tick in chart.y.ticks:
        at = frame.y(tick.at)
        if not chart.y.is_names:
            kind = "axis" if tick.at == chart.y.low else "rule"
            yield _path(kind, ((frame.left, at), (frame.right, at)))
        yield _text(frame.left - 6, at + 4, tick.text, "end ink" if chart.y.is_names else "end")
    for tick in chart.x.ticks:
        if chart.y.is_names:
            at = frame.x(tick.at)
            yield _path("rule", ((at, frame.top), (at, frame.bottom)))
        if frame.is_last:
            yield _text(frame.x(tick.at), frame.bottom + 15, tick.text, "middle")
    if chart.y.label:
        yield _text(10, (frame.top + frame.bottom) / 2, chart.y.label, "middle", is_upright=True)


def _mark(frame: PlotArea, mark: Mark) -> str:
    match mark:
        case Line(points=(_,)):  # as a line it would not be seen
            return _mark(frame, Spots(mark.points, mark.tone, POINT))
        case Line():
            more = f' stroke-width="{mark.width:g}"{_faint(mark.opacity)}'
            points = [(frame.x(x), frame.y(y)) for x, y in mark.points]
            return _path(f"line {mark.tone}", points, more)
        case Band():
            outline = [(frame.x(x), frame.y(y)) for x, y in mark.points]
            return _path(f"area {mark.tone}", outline, _faint(mark.opacity))
        case Spots():
            drawn = "".join(f"M{_n(frame.x(x))} {_n(frame.y(y))}h0" for x, y in mark.points)
            links = f' data-episodes="{" ".join(map(str, mark.episodes))}"' if mark.episodes else ""
            size = f'stroke-width="{_n(mark.size)}"'
            return f'<path class="spots {mark.tone}" {size}{links} d="{drawn}"/>'
        case Blocks():
            drawn = "".join(_box(frame, *box) for box in mark.boxes)
            return f'<path class="area {mark.tone}" d="{drawn}"/>'


def _box(frame: PlotArea, left: float, bottom: float, right: float, top: float) -> str:
    x, y = frame.x(left), frame.y(top)
    across, down = _n(frame.x(right) - x), _n(frame.y(bottom) - y)
    return f"M{_n(x)} {_n(y)}h{across}v{down}H{_n(x)}Z"


def _faint(opacity: float) -> str:
    return "" if opacity == 1 else f' opacity="{opacity:g}"'


def _path(kind: str, points: Sequence[tuple[float, float]], more: str = "") -> str:
    """Draw a line through points; more than two of another kind are the corners of an area."""
    end = "Z" if len(points) > 2 and not kind.startswith("line") else ""
    drawn = "L".join(f"{_n(x)} {_n(y)}" for x, y in points)
    return f'<path class="{kind}"{more} d="M{drawn}{end}"/>'


def _text(x: float, y: float, text: str, kind: str, *, is_upright: bool = False) -> str:
    turned = f' transform="rotate(-90 {_n(x)} {_n(y)})"' if is_upright else ""
    return f'<text class="{kind}" x="{_n(x)}" y="{_n(y)}"{turned}>{html.escape(text)}</text>'


def _n(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")
