"""What a page is made of: one frame, one style, one Jinja environment, and a task's card.

A page loads no script, style or font; a policy of hashes forbids all but its own. A new kind of
page extends ``base.html.j2`` and takes its tables, figures and cards from ``kit.html.j2``.
"""

import base64
import hashlib
import math
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup

from minitouch_bench.episode import Episode, Role
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.reporting.charts import draw_plot, series_tone
from minitouch_bench.reporting.endings import Ending, ending_of
from minitouch_bench.reporting.labels import PAPER_METHODS, estimate_cell, paper_value, task_title
from minitouch_bench.reporting.tables import Cell
from minitouch_bench.runs.run import Run
from minitouch_bench.text import printable

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
    environment.filters |= {"printable": printable, "draw": draw_plot, "tone": series_tone}
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
    return {"style": Markup(style), "scripts": tuple(map(Markup, texts)), "policy": Markup(policy)}


def _hash(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"


def image_uri(task: str) -> str:
    """Return a task's image as a data URI."""
    image = (PICTURES / f"{task}.png").read_bytes()
    return "data:image/png;base64," + base64.b64encode(image).decode("ascii")


# Cards

BESIDE_SUCCESS = ("episode_steps", "touch_interaction", "peak_force", "contact_force")
BESIDE_TOUCH = ("touched", "time_to_first_touch", "peak_force", "contact_force")
"""What a card shows beside the value that sums its task up."""


@dataclass(frozen=True)
class CardValue:
    """The value of one run, and further ones beside it by label and unit."""

    name: str
    cell: Cell
    beside: tuple[tuple[str, Cell], ...]


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
    task: str,
    runs: Sequence[tuple[str, Mapping[str, Estimate]]],
    image: str,
    rank: str = "",
    *,
    with_paper: bool = True,
) -> Card:
    """Compose a task's card of ``runs`` (names, estimates), with the paper's own method."""
    metric = ranking_metric(task)
    paper = paper_value(task, metric, PAPER_METHODS[0]) if with_paper else ""
    beside = BESIDE_SUCCESS if task in GOAL_TASKS else BESIDE_TOUCH
    values = tuple(
        CardValue(
            name=name,
            cell=estimate_cell(metric, estimates.get(metric), paper),
            beside=tuple(
                (_label_with_unit(other, task), estimate_cell(other, estimates.get(other)))
                for other in beside
            ),
        )
        for name, estimates in runs
    )
    return Card(
        title=task_title(task),
        metric=_label_with_unit(metric, task),
        image=image,
        paper=f"{PAPER_METHODS[0]} in the paper: {paper}" if paper else "",
        values=values,
        rank=rank,
    )


def _label_with_unit(metric: str, task: str) -> str:
    label = f"{METRICS[metric].label}, {METRICS[metric].unit_in(task)}"
    if metric == "peak_force":
        # The touch vector clips each of the three components of a force.
        label += f" (sensor limit {math.sqrt(3) * PROTOCOL.task(task).force_limit:.0f})"
    return label


@dataclass(frozen=True)
class BrowsedRun:
    """A run in the browser of a page.

    ``address``: of the run's directory, relative to the page; a page that is opened from a disk
    shows the path it leads to. ``viewers``: addresses of the viewers that this process made, by
    episode. What lies in a run's directory may be a stranger's page, so it is not looked for.
    ``evaluate``: the command that plays it again, for a run whose actions are not kept.
    """

    title: str
    run: Run
    address: str = ""
    viewers: Mapping[str, str] = field(default_factory=dict)
    evaluate: str = ""


def relative_address(path: Path, page: Path) -> str:
    """Return the address of a file or directory for a page in the directory ``page``."""
    return quote(Path(os.path.relpath(path, page)).as_posix())


def browser_data(runs: Sequence[BrowsedRun], tasks: Collection[str] = ()) -> Markup:
    """Write the episodes as JSON that no reader of HTML takes for markup.

    ``tasks``: those whose episodes are shown, () for all.
    """
    document = {
        "endings": [ending.value for ending in Ending],
        "tones": [ending.tone for ending in Ending],
        "failures": list(Ending).index(Ending.TOUCHED_FAILED),
        "runs": [
            {
                "title": one.title,
                "evaluate": one.evaluate,
                "address": one.address,
                "viewers": one.viewers,
                "groups": list(_groups(one.run, tasks)),
            }
            for one in runs
        ],
    }
    return htmlsafe_json_dumps(document, separators=(",", ":"), allow_nan=False)


def _groups(run: Run, tasks: Collection[str]) -> Iterator[dict[str, Any]]:
    """Yield the episodes of each role and task, a list per column."""
    endings = list(Ending)
    for role, rows in run.by_role():
        for task in dict.fromkeys(row.task for row in rows if not tasks or row.task in tasks):
            episodes = [row for row in rows if row.task == task]
            shapes = [printable(row.shape) for row in episodes]
            yield {
                "key": task if role is Role.FINAL else f"exploration/{task}",
                "index": [row.index for row in episodes],
                "ending": [endings.index(ending_of(row)) for row in episodes],
                "steps": [row.steps for row in episodes],
                "ticks": [row.touch_interaction for row in episodes],
                "share": [_rounded("touch_share", row) for row in episodes],
                "first": [_rounded("time_to_first_touch", row) for row in episodes],
                "shapes": shapes if len(set(shapes)) > 1 else None,
            }


def _rounded(metric: str, episode: Episode) -> float | None:
    """Return a metric's value in few digits, None where there is none."""
    value = METRICS[metric].value(episode)
    return None if value is None else round(value, 3)
