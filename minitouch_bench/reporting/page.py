"""``report.html``: one self-contained page that opens offline."""

from pathlib import Path

from minitouch_bench.metrics.definitions import ranking_metric
from minitouch_bench.rendering.pages import Card, Reference, make_card, picture_uri, render_page
from minitouch_bench.rendering.palette import series_tone
from minitouch_bench.reporting.figures import report_figures, split_figures
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.paper import PAPER_METHODS, paper_value
from minitouch_bench.reporting.report import Report
from minitouch_bench.reporting.tables import task_summary

TEMPLATE = Path(__file__).parent / "templates" / "report.html.j2"


def to_html(report: Report) -> str:
    """Write a report as an HTML page."""
    return render_page(
        TEMPLATE,
        report=report,
        cards=tuple(report_card(report, task) for task in report.tasks),
        figures=report_figures(report),
        split_figures=split_figures(report),
        tones=tuple(series_tone(index) for index in range(len(report.sections))),
    )


def report_card(report: Report, task: str) -> Card:
    """Compose the card of a task."""
    found = ((section.name, task_summary(section.run, task)) for section in report.sections)
    runs = [(name, summary.estimates if summary else {}) for name, summary in found]
    return make_card(
        task,
        task_title(task),
        runs,
        paper=paper_reference(task),
        picture=picture_uri(task),
    )


def paper_reference(task: str) -> Reference | None:
    """Return what the paper's own method reached in the metric that sums a task up."""
    value = paper_value(task, ranking_metric(task), PAPER_METHODS[0])
    return Reference(PAPER_METHODS[0], value.text) if value and value.is_our_unit else None
