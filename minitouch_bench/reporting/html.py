"""``report.html``: one self-contained page that opens offline."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting import plots
from minitouch_bench.reporting.cards import build_cards
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.report import Report
from minitouch_bench.reporting.tables import OUTCOME_TITLES

TEMPLATES = Path(__file__).parent / "templates"
TASKS_WITH_LENGTHS = GOAL_TASKS
"""Playing always lasts until the step limit; its lengths say nothing."""


@dataclass(frozen=True)
class Figure:
    """A row of drawings under one heading; ``key`` says which legend they need."""

    title: str
    text: str
    key: str
    drawings: tuple[tuple[str, Markup], ...]


def to_html(report: Report) -> str:
    """Write a report as an HTML page."""
    page = page_environment().get_template("report.html.j2")
    return page.render(
        report=report,
        cards=build_cards(report),
        figures=_figures(report),
        split_figures=_split_figures(report),
        outcomes=tuple(OUTCOME_TITLES.values()),
        series=len(plots.SERIES),
    )


def page_environment() -> Environment:
    """Return the templates: everything escaped, and a missing variable is an error."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["printable"] = printable
    return environment


def _figures(report: Report) -> tuple[Figure, ...]:
    """Draw the plots that the report's tasks have."""
    sections = report.sections
    goals = [task for task in report.tasks if task in TASKS_WITH_LENGTHS]
    found = (
        Figure(
            "Against the paper",
            "Filled: this report, with its 95 % interval. Hollow: the paper's own figures, "
            "from other episodes and object sets.",
            "",
            _draw(
                report.tasks, lambda task: plots.estimate_plot(task, ranking_metric(task), sections)
            ),
        ),
        Figure(
            "How long episodes last",
            "Share of a run's episodes by number of control steps, and by how they ended.",
            "outcomes",
            _draw(goals, lambda task: plots.steps_plot(task, sections)),
        ),
        Figure(
            "Touch over time",
            "Mean ticks in contact at each control step, over the episodes that reached it; "
            "faint where fewer than a tenth of the episodes are left.",
            "series",
            _draw(report.tasks, lambda task: plots.touch_plot(task, sections)),
        ),
    )
    return tuple(figure for figure in found if figure.drawings)


def _split_figures(report: Report) -> tuple[Figure, ...]:
    """Draw held-out beside train shapes, as the paper's Figure 11, and by family."""
    sections = report.sections
    compared = {result.task for s in sections for result in s.run.summary.generalization}
    tasks = [task for task in report.tasks if task in compared]
    if not tasks:
        return ()
    overall = [
        (f"{task_title(task)}: {METRICS[metric].label.lower()}", task, metric)
        for task in tasks
        for metric in _figure_11(task)
    ]
    return (
        Figure(
            "Held-out beside train shapes",
            "Each with its 95 % interval, in the manner of the paper's Figure 11.",
            "splits",
            tuple(
                (title, Markup(plots.split_plot(task, metric, sections)))
                for title, task, metric in overall
            ),
        ),
        Figure(
            "Families of shapes",
            "Success, in Playing touch share, by family. A ring around a dot: no difference.",
            "splits",
            _draw(tasks, lambda task: plots.family_plot(task, sections)),
        ),
    )


def _figure_11(task: str) -> tuple[str, str]:
    """Return the two metrics that the paper's Figure 11 and its text compare."""
    if task in GOAL_TASKS:
        return ("success", "episode_steps")
    return ("touch_share", "object_movement")


def _draw(tasks: Sequence[str], draw: Callable[[str], str]) -> tuple[tuple[str, Markup], ...]:
    """Draw one plot a task; the drawings are ours, their text is escaped by matplotlib."""
    return tuple((task_title(task), Markup(draw(task))) for task in tasks)
