"""Pages that are complete in themselves: one frame, one style, one Jinja environment.

A page loads no script, style or font; a policy of hashes forbids all but its own. At its head
stands a card per task, with the value that sums it up.
"""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import Estimate
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.palette import COLORS, series_tone
from minitouch_bench.rendering.svg import draw_gauge, draw_plot
from minitouch_bench.rendering.tables import Cell, estimate_cell

TEMPLATES = Path(__file__).parent / "templates"
STYLE = "page.css"

PICTURES = Path(__file__).parent / "pictures"
BESIDE_SUCCESS = ("episode_steps", "touch_interaction")
BESIDE_TOUCH = ("touched", "time_to_first_touch")


def render_page(
    template: Path, styles: tuple[str, ...] = (), scripts: tuple[str, ...] = (), **context: object
) -> str:
    """Render a template that fills the page's frame.

    ``styles`` and ``scripts`` name files beside the template, or the kit's own; they become
    part of the page.
    """
    environment = _environment(template.parent)
    frame = _frame(template.parent, (STYLE, *styles), scripts)
    return environment.get_template(template.name).render(**frame, **context)


@cache
def _environment(templates: Path) -> Environment:
    """Return the templates: everything escaped, and a missing variable is an error."""
    environment = Environment(
        loader=FileSystemLoader([templates, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"printable": printable, "draw": draw_plot, "gauge": draw_gauge}
    return environment


@cache
def _frame(templates: Path, styles: tuple[str, ...], scripts: tuple[str, ...]) -> dict[str, object]:
    """Return the texts of a page's style and scripts, and the policy that allows these alone."""
    environment = _environment(templates)
    style = "".join(environment.get_template(name).render(colors=COLORS) for name in styles)
    texts = [environment.get_template(name).render() for name in scripts]
    policy = (
        f"default-src 'none'; style-src {_hash(style)}; "
        + (f"script-src {' '.join(map(_hash, texts))}; " if texts else "")
        + "img-src 'self' file: data:; media-src 'self' file:; base-uri 'none'; form-action 'none'"
    )
    return {
        "style": Markup(style),
        "scripts": tuple(map(Markup, texts)),
        "policy": Markup(policy),
    }


def _hash(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"


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
        metric=f"{METRICS[metric].label}, {METRICS[metric].unit_in(task)}",
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
