"""A chart as data, in the units of its axes; ``svg`` draws it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from minitouch_bench.metrics.intervals import Estimate

RUN_COLORS = 7
"""Colors of runs in ``page.css``, which has the shades of every color that a mark can name."""


def series_tone(index: int) -> str:
    """Return the color of the run at this position; the eighth has that of the first."""
    return f"series-{index % RUN_COLORS}"


MarkShape = Literal["circle", "square", "up", "down", "plus", "cross", "diamond"]
MARK_SHAPES: tuple[MarkShape, ...] = ("circle", "square", "up", "down", "plus", "cross")
"""The marks of runs, in the order they are given out."""

THOUSANDS_FROM = 10_000
"""Highest value from which an axis counts in thousands, as "2.5k"."""

ROW = 23.0
"""Height of a row of dots, drawing units."""

LONGEST_LABEL = 16
"""Characters of a name that fit beside a chart."""


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
class Dot:
    """A point; ``size``: its height, drawing units."""

    x: float
    y: float
    tone: str
    shape: MarkShape = "circle"
    size: float = 8.0
    is_hollow: bool = False


@dataclass(frozen=True)
class Spots:
    """Round dots of one color, drawn as one path, so that a page of thousands stays small.

    ``size``: their height, drawing units. ``episodes``: the index of each one's episode in the
    plot's ``source``, () where a reader cannot go to them.
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


Mark = Line | Band | Dot | Spots | Blocks


@dataclass(frozen=True)
class Tick:
    """A labeled value of an axis."""

    at: float
    text: str
    tone: str = "muted"


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

    @property
    def span(self) -> float:
        """Its length."""
        return abs(self.high - self.low)


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
    """What a color or a mark stands for."""

    text: str
    tone: str
    shape: MarkShape = "square"
    is_hollow: bool = False
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


def step_axis(last: int) -> Axis:
    """Return an axis over the control steps of an episode."""
    return Axis(
        "Control steps", 0.0, last, tuple(Tick(step, str(step)) for step in range(0, last + 1, 50))
    )


def name_axis(names: Sequence[str], muted: Sequence[str] = ()) -> Axis:
    """Return an axis that names rows from the top down: ``names`` in ink, then ``muted``."""
    texts = [*zip(names, ["ink"] * len(names), strict=True), *((text, "muted") for text in muted)]
    ticks = tuple(Tick(row, text, tone) for row, (text, tone) in enumerate(texts))
    return Axis("", len(ticks) - 0.5, -0.5, ticks, is_names=True)


def _round_step(least: float) -> float:
    """Return the smallest of 1, 2, 2.5 or 5 times a power of ten that is no smaller."""
    if least <= 0 or not math.isfinite(least):
        return 1.0
    size = 10.0 ** math.floor(math.log10(least))
    return next(step * size for step in (1, 2, 2.5, 5, 10) if step * size >= least * (1 - 1e-9))


# Marks


def estimate_marks(
    index: int, row: float, estimate: Estimate, *, size: float = 8.0, is_hollow: bool = False
) -> tuple[Line, Dot]:
    """Return an estimate of the run at ``index`` in a row: its interval, and the run's dot."""
    tone, shape = series_tone(index), MARK_SHAPES[index % len(MARK_SHAPES)]
    return (
        Line(((estimate.low, row), (estimate.high, row)), tone, 2.2, 0.6),
        Dot(estimate.value, row, tone, shape, size, is_hollow),
    )


# Names


def short_names(names: Sequence[str]) -> tuple[str, ...]:
    """Shorten names to fit beside a chart; they stay different, by their numbers if need be."""
    short = [n if len(n) <= LONGEST_LABEL else f"{n[: LONGEST_LABEL - 1]}…" for n in names]
    if len(set(short)) == len(set(names)):
        return tuple(short)
    return tuple(
        name if len(name) <= LONGEST_LABEL else f"{name[: LONGEST_LABEL - 4]}… {number}"
        for number, name in enumerate(names, start=1)
    )
