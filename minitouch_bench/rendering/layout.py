"""Where the parts of a plot stand, in drawing units; pages and files place them alike."""

import unicodedata
from dataclasses import dataclass

from minitouch_bench.rendering.charts import Axis, Chart, Dot, Plot

WIDTH = 260
"""Drawing units across a plot; a unit is about a pixel."""

FONT_SIZE = 11.0
CHARACTER = 6.4
"""Width of an average character at that size."""

PAD = 7
"""Space around dots, so that one at the end of an axis is drawn whole."""

TITLE, NUMBERS, LABEL, GAP = 18.0, 18.0, 18.0, 10.0
"""Heights: a chart's title, the numbers and the label below the last chart, between charts."""


@dataclass(frozen=True)
class Frame:
    """The area between a chart's axes; y grows downwards. ``is_last``: it has the x axis."""

    chart: Chart
    left: float
    right: float
    top: float
    is_last: bool

    @property
    def bottom(self) -> float:
        """The height of the x axis."""
        return self.top + self.chart.height

    @property
    def pad(self) -> float:
        """Space between the frame and the ends of its axes."""
        return PAD if any(isinstance(mark, Dot) for mark in self.chart.marks) else 0.0

    def x(self, value: float) -> float:
        """Return where a value of the x axis stands."""
        return _scaled(value, self.chart.x, self.left + self.pad, self.right - self.pad)

    def y(self, value: float) -> float:
        """Return where a value of the y axis stands."""
        return _scaled(value, self.chart.y, self.bottom - self.pad, self.top + self.pad)


@dataclass(frozen=True)
class Layout:
    """The frames of a plot from the top down, its height, and where its x axis is labeled."""

    frames: tuple[Frame, ...]
    height: float
    label: float


def lay_out(plot: Plot, width: float = WIDTH) -> Layout:
    """Place the charts of a plot below each other, on one left edge."""
    left = max(_left_margin(chart.y) for chart in plot.charts)
    right = width - max(map(_right_margin, plot.charts))
    frames: list[Frame] = []
    top = 4.0
    for chart in plot.charts:
        top += TITLE if chart.title else 0.0
        frames.append(Frame(chart, left, right, top, chart is plot.charts[-1]))
        top = frames[-1].bottom + GAP
    label = plot.charts[-1].x.label
    half = text_width(label) / 2
    center = min(max((left + right) / 2, half), width - half)
    height = frames[-1].bottom + NUMBERS + (LABEL if label else 0.0)
    return Layout(tuple(frames), height, center)


def text_width(text: str) -> float:
    """Estimate the width of a text."""
    wide = sum(unicodedata.east_asian_width(character) in "WF" for character in text)
    return CHARACTER * (len(text) + wide)


def _left_margin(axis: Axis) -> float:
    widest = max((text_width(tick.text) for tick in axis.ticks), default=0.0)
    return widest + 8 + (14 if axis.label else 0)


def _right_margin(chart: Chart) -> float:
    """Leave room for half of the last number, and for the labels behind the dots."""
    last = max(chart.x.ticks, key=lambda tick: tick.at, default=None)
    room = text_width(last.text) / 2 - PAD if last else 0.0
    labels = (text_width(mark.label) for mark in chart.marks if isinstance(mark, Dot))
    return max(2.0, room, *labels)


def _scaled(value: float, axis: Axis, start: float, end: float) -> float:
    return start + (value - axis.low) / (axis.high - axis.low) * (end - start)
