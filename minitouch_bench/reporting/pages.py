"""What a page is made of: one frame, one style, one Jinja environment, and a task's card.

A page loads no script, style or font; a policy of hashes forbids all but its own. A new kind of
page extends ``base.html.j2`` and takes its tables, figures and cards from ``kit.html.j2``.
"""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from minitouch_bench.errors import printable
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.reporting.charts import series_tone
from minitouch_bench.reporting.labels import PAPER_METHODS, estimate_cell, paper_value, task_title
from minitouch_bench.reporting.svg import draw_gauge, draw_plot
from minitouch_bench.reporting.tables import Cell

TEMPLATES = Path(__file__).parent / "templates"
PICTURES = Path(__file__).parent / "pictures"
STYLE = "page.css"


def render_page(
    template: Path, styles: tuple[str, ...] = (), scripts: tuple[str, ...] = (), **context: object
) -> str:
    """Render a template; ``styles`` and ``scripts``, beside it or the kit's, become part of it."""
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
    style = "".join(environment.get_template(name).render() for name in styles)
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


def image_uri(task: str) -> str:
    """Return a task's image as a data URI."""
    image = (PICTURES / f"{task}.png").read_bytes()
    return "data:image/png;base64," + base64.b64encode(image).decode("ascii")


# Cards

BESIDE_SUCCESS = ("episode_steps", "touch_interaction")
BESIDE_TOUCH = ("touched", "time_to_first_touch")
"""What a card shows beside the value that sums its task up."""


@dataclass(frozen=True)
class CardValue:
    """The value of one run, and further ones beside it by label."""

    name: str
    tone: str
    cell: Cell
    beside: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Card:
    """One task. ``image`` is the address of its image, "" for none; ``rank`` "" where unranked."""

    title: str
    metric: str
    image: str
    paper: str
    values: tuple[CardValue, ...]
    rank: str


def make_card(
    task: str, runs: Sequence[tuple[str, Mapping[str, Estimate]]], image: str, rank: str = ""
) -> Card:
    """Compose a task's card of ``runs`` (names, estimates), with the paper's own method."""
    metric = ranking_metric(task)
    printed = paper_value(task, metric, PAPER_METHODS[0])
    paper = printed.text if printed and printed.is_our_unit else ""
    beside = BESIDE_SUCCESS if task in GOAL_TASKS else BESIDE_TOUCH
    values = tuple(
        CardValue(
            name=name,
            tone=series_tone(index),
            cell=estimate_cell(metric, estimates.get(metric), float(paper) if paper else None),
            beside=tuple((METRICS[other].label, _with_unit(other, estimates)) for other in beside),
        )
        for index, (name, estimates) in enumerate(runs)
    )
    return Card(
        title=task_title(task),
        metric=f"{METRICS[metric].label}, {METRICS[metric].unit_in(task)}",
        image=image,
        paper=f"{PAPER_METHODS[0]} in the paper: {paper}" if paper else "",
        values=values,
        rank=rank,
    )


def _with_unit(metric: str, estimates: Mapping[str, Estimate]) -> str:
    estimate = estimates.get(metric)
    unit = " s" if estimate and METRICS[metric].unit == "s" else ""
    return estimate_cell(metric, estimate).text + unit
