"""The cards at the head of a page: one per task, with the value that sums it up."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.metrics.definitions import METRICS, ranking_metric, unit_of
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import Estimate
from minitouch_bench.rendering.palette import series_tone
from minitouch_bench.rendering.tables import Cell, estimate_cell

PICTURES = Path(__file__).parent / "pictures"
BESIDE_SUCCESS = ("episode_steps", "touch_interaction")
BESIDE_TOUCH = ("touched", "time_to_first_touch")


@dataclass(frozen=True)
class CardValue:
    """The value of one run, and further ones beside it by label."""

    name: str
    tone: str
    cell: Cell
    beside: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Card:
    """One task. ``picture`` is its picture's address, "" for none; ``rank`` "" where unranked."""

    title: str
    metric: str
    picture: str
    paper: str
    values: tuple[CardValue, ...]
    rank: str = ""


@dataclass(frozen=True)
class Reference:
    """The value printed in the paper that a card marks on its gauge."""

    method: str
    printed: str


def make_card(
    task: str,
    title: str,
    runs: Sequence[tuple[str, Mapping[str, Estimate]]],
    *,
    paper: Reference | None = None,
    picture: str = "",
    rank: str = "",
) -> Card:
    """Compose the card of a task; ``runs``: names, and estimates by metric."""
    metric = ranking_metric(task)
    mark = float(paper.printed) if paper else None
    beside = BESIDE_SUCCESS if task in GOAL_TASKS else BESIDE_TOUCH
    values = tuple(
        CardValue(
            name=name,
            tone=series_tone(index),
            cell=estimate_cell(metric, estimates.get(metric), mark),
            beside=tuple((METRICS[one].label, _with_unit(one, estimates)) for one in beside),
        )
        for index, (name, estimates) in enumerate(runs)
    )
    return Card(
        title=title,
        metric=f"{METRICS[metric].label}, {unit_of(metric, task)}",
        picture=picture,
        paper=f"{paper.method} in the paper: {paper.printed}" if paper else "",
        values=values,
        rank=rank,
    )


def picture_uri(task: str, pictures: Path = PICTURES) -> str:
    """Return a task's picture as a data URI, "" if its file is missing."""
    file = pictures / f"{Path(task).name}.png"
    if not file.is_file():
        return ""
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode("ascii")


def _with_unit(metric: str, estimates: Mapping[str, Estimate]) -> str:
    """Write a value beside the verdict; a time with its unit."""
    estimate = estimates.get(metric)
    unit = " s" if estimate and METRICS[metric].unit == "s" else ""
    return estimate_cell(metric, estimate).text + unit
