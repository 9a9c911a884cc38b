"""Charts as SVG, inline on pages.

Drawn directly, by measurement: the 19 plots of a report on novel shapes take 5 ms and 50 kB, with
matplotlib 1 s, 0.5 s to import it, and 213 kB. The drawings carry classes and attributes, no
styles, so that a page's policy can forbid every style but its own, and they take the page's colors,
light or dark, and its font. A drawing is made of paths of straight lines, circles and texts alone.
"""

import html
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.reporting import charts

WIDTH = 260
"""Drawing units across a plot; a unit is about a pixel."""

CHARACTER = 6.4
"""Width of an average character of the drawing's font, 11 units high."""

PAD = 7
"""Space around dots, so that one at the end of an axis is drawn whole."""

POINT = 5.0
"""Size of a line's only point."""

TITLE, NUMBERS, LABEL, GAP = 18.0, 18.0, 18.0, 10.0
"""Heights: a chart's title, the numbers and the label below the last chart, between charts."""


@dataclass(frozen=True)
class PlotArea:
    """The area between a chart's axes, y downwards, ``pad`` wider than they are."""

    chart: charts.Chart
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
        across = (self.right - self.left - 2 * self.pad) / self.chart.x.span
        return self.top + across * self.chart.y.span + 2 * self.pad

    def x(self, value: float) -> float:
        """Return where a value of the x axis stands."""
        return _scaled(value, self.chart.x, self.left + self.pad, self.right - self.pad)

    def y(self, value: float) -> float:
        """Return where a value of the y axis stands."""
        return _scaled(value, self.chart.y, self.bottom - self.pad, self.top + self.pad)


def text_width(text: str) -> float:
    """Estimate the width of a text."""
    wide = sum(unicodedata.east_asian_width(character) in "WF" for character in text)
    return CHARACTER * (len(text) + wide)


def _left_margin(axis: charts.Axis) -> float:
    widest = max((text_width(tick.text) for tick in axis.ticks), default=0.0)
    return widest + 8 + (14 if axis.label else 0)


def _right_margin(chart: charts.Chart) -> float:
    """Leave room for half of the last number."""
    last = max(chart.x.ticks, key=lambda tick: tick.at, default=None)
    return max(2.0, text_width(last.text) / 2 - PAD) if last else 2.0


def _scaled(value: float, axis: charts.Axis, start: float, end: float) -> float:
    return start + (value - axis.low) / (axis.high - axis.low) * (end - start)


_A, _B = 0.36, 1.05
_PLUS = (
    *((-_A, -_B), (_A, -_B), (_A, -_A), (_B, -_A), (_B, _A), (_A, _A)),
    *((_A, _B), (-_A, _B), (-_A, _A), (-_B, _A), (-_B, -_A), (-_A, -_A)),
)
_OUTLINES = {
    "square": ((-0.88, -0.88), (0.88, -0.88), (0.88, 0.88), (-0.88, 0.88)),
    "up": ((0, -1.1), (1, 0.85), (-1, 0.85)),
    "down": ((0, 1.1), (1, -0.85), (-1, -0.85)),
    "diamond": ((0, -1.15), (1.15, 0), (0, 1.15), (-1.15, 0)),
    "plus": _PLUS,
    "cross": tuple(((x - y) * 0.71, (x + y) * 0.71) for x, y in _PLUS),
}
"""Corners of the marks, for a circle of radius 1 beside them."""


def draw_plot(plot: charts.Plot) -> Markup:
    """Draw the charts of a plot below each other, on one left edge and one x axis."""
    left = max(_left_margin(chart.y) for chart in plot.charts)
    right = WIDTH - max(map(_right_margin, plot.charts))
    parts: list[str] = []
    bottom = 4.0 - GAP
    for chart in plot.charts:
        top = bottom + GAP + (TITLE if chart.title else 0.0)
        pad = PAD if any(isinstance(mark, charts.Dot) for mark in chart.marks) else 0.0
        area = PlotArea(chart, left, right, top, pad, chart is plot.charts[-1])
        bottom = area.bottom
        if chart.title:
            parts.append(_text(0, top - 8, chart.title, "ink"))
        parts += _grid(area)
        parts += [part for mark in chart.marks for part in _mark(area, mark)]
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
        yield _text(frame.left - 6, at + 4, tick.text, f"end {tick.tone}")
    for tick in chart.x.ticks:
        if chart.y.is_names:
            at = frame.x(tick.at)
            yield _path("rule", ((at, frame.top), (at, frame.bottom)))
        if frame.is_last:
            yield _text(frame.x(tick.at), frame.bottom + 15, tick.text, "middle")
    if chart.y.label:
        yield _text(10, (frame.top + frame.bottom) / 2, chart.y.label, "middle", is_upright=True)


def _mark(frame: PlotArea, mark: charts.Mark) -> Iterator[str]:
    match mark:
        case charts.Line(points=((x, y),)):  # as a line it would not be seen
            yield _dot(charts.Dot(x, y, mark.tone, size=POINT), frame.x(x), frame.y(y))
        case charts.Line():
            more = f' stroke-width="{mark.width:g}"{_faint(mark.opacity)}'
            points = [(frame.x(x), frame.y(y)) for x, y in mark.points]
            yield _path(f"line {mark.tone}", points, more)
        case charts.Band():
            outline = [(frame.x(x), frame.y(y)) for x, y in mark.points]
            yield _path(f"area {mark.tone}", outline, _faint(mark.opacity))
        case charts.Dot():
            yield _dot(mark, frame.x(mark.x), frame.y(mark.y))
        case charts.Spots():
            drawn = "".join(f"M{_n(frame.x(x))} {_n(frame.y(y))}h0" for x, y in mark.points)
            links = f' data-episodes="{" ".join(map(str, mark.episodes))}"' if mark.episodes else ""
            size = f'stroke-width="{_n(mark.size)}"'
            yield f'<path class="spots {mark.tone}" {size}{links} d="{drawn}"/>'
        case charts.Blocks():
            drawn = "".join(_box(frame, *box) for box in mark.boxes)
            yield f'<path class="area {mark.tone}" d="{drawn}"/>'


def _box(frame: PlotArea, left: float, bottom: float, right: float, top: float) -> str:
    x, y = frame.x(left), frame.y(top)
    across, down = _n(frame.x(right) - x), _n(frame.y(bottom) - y)
    return f"M{_n(x)} {_n(y)}h{across}v{down}H{_n(x)}Z"


def _faint(opacity: float) -> str:
    return "" if opacity == 1 else f' opacity="{opacity:g}"'


def _dot(dot: charts.Dot, x: float, y: float) -> str:
    """Draw a mark about as large as a circle of its size."""
    kind, r = f"dot {'hollow ' if dot.is_hollow else ''}{dot.tone}", dot.size / 2
    if dot.shape == "circle":
        return f'<circle class="{kind}" cx="{_n(x)}" cy="{_n(y)}" r="{_n(r)}"/>'
    return _path(kind, [(x + r * dx, y + r * dy) for dx, dy in _OUTLINES[dot.shape]])


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
