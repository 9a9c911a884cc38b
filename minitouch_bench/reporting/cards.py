"""The cards at the head of a page: one a task, with its verdict number."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.metrics.definitions import METRICS, ranking_metric, unit_of
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import Estimate
from minitouch_bench.rendering.tables import Cell, estimate_cell
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.paper import PAPER_METHODS, paper_value
from minitouch_bench.reporting.report import Report, RunSection
from minitouch_bench.reporting.tables import find_estimate

PICTURES = Path(__file__).parents[1] / "rendering" / "pictures"
BESIDE_SUCCESS = ("episode_steps", "touch_interaction")
BESIDE_TOUCH = ("touched", "time_to_first_touch")
HEADROOM = 1.1
"""A gauge without a natural end reaches a tenth beyond the largest figure on it."""


@dataclass(frozen=True)
class Gauge:
    """A scale from 0 to ``end`` with an interval and the paper's mark, places in percent."""

    value: float
    low: float
    high: float
    paper: float | None
    end: str


@dataclass(frozen=True)
class CardFigure:
    """One run's verdict on a task, its gauge, and the figures beside it."""

    name: str
    cell: Cell
    gauge: Gauge | None
    beside: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Card:
    """One task: ``picture`` is a data URI, "" where there is none."""

    title: str
    metric: str
    unit: str
    picture: str
    paper: str
    figures: tuple[CardFigure, ...]


def build_cards(report: Report, pictures: Path = PICTURES) -> tuple[Card, ...]:
    """Compose the cards of a report in its order of tasks."""
    return tuple(_card(task, report.sections, pictures) for task in report.tasks)


def picture_uri(task: str, pictures: Path = PICTURES) -> str:
    """Return a task's picture as a data URI, "" if its file is missing."""
    file = pictures / f"{Path(task).name}.png"
    if not file.is_file():
        return ""
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode("ascii")


def _card(task: str, sections: Sequence[RunSection], pictures: Path) -> Card:
    """Compose the card of one task."""
    metric = ranking_metric(task)
    printed = paper_value(task, metric, PAPER_METHODS[0])
    paper = printed.number if printed else None
    estimates = [find_estimate(section.run, task, metric) for section in sections]
    highest = max([e.high for e in estimates if e] + [paper or 0.0])
    end = 1.0 if METRICS[metric].is_share else highest * HEADROOM
    figures = [
        CardFigure(
            name=section.name,
            cell=estimate_cell(metric, estimate),
            gauge=_gauge(estimate, paper, end),
            beside=_beside(task, section, BESIDE_SUCCESS if task in GOAL_TASKS else BESIDE_TOUCH),
        )
        for section, estimate in zip(sections, estimates, strict=True)
    ]
    return Card(
        title=task_title(task),
        metric=METRICS[metric].label,
        unit=unit_of(metric, task),
        picture=picture_uri(task, pictures),
        paper=f"{PAPER_METHODS[0]} in the paper: {printed.text}" if printed else "",
        figures=tuple(figures),
    )


def _gauge(estimate: Estimate | None, paper: float | None, end: float) -> Gauge | None:
    """Place an estimate on its scale."""
    if estimate is None or end <= 0:
        return None
    return Gauge(
        value=_percent(estimate.value, end),
        low=_percent(estimate.low, end),
        high=_percent(estimate.high, end),
        paper=None if paper is None else _percent(paper, end),
        end=f"{end:.0f}",
    )


def _percent(value: float, end: float) -> float:
    """Return a place on a scale, within it."""
    return round(min(max(value / end, 0.0), 1.0) * 100, 2)


def _beside(task: str, section: RunSection, metrics: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Return label and figure of the metrics beside the verdict."""
    figures = []
    for metric in metrics:
        estimate = find_estimate(section.run, task, metric)
        unit = " s" if estimate and METRICS[metric].unit == "s" else ""
        figures.append((METRICS[metric].label, estimate_cell(metric, estimate).text + unit))
    return tuple(figures)
