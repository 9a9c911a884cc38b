"""A report in its forms: the page ``report.html``, a terminal, and Table 4 as text."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from rich.console import Console

from minitouch_bench import files
from minitouch_bench.episode import Estimate
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.reporting.charts import series_tone
from minitouch_bench.reporting.figures import report_figures, split_figures
from minitouch_bench.reporting.formats import (
    Block,
    Heading,
    NoteBlock,
    on_screen,
    table_latex,
    table_section,
)
from minitouch_bench.reporting.frames import episodes_csv, table4_csv, table4_json
from minitouch_bench.reporting.labels import PAPER_METHODS, fault_lines, paper_value, task_title
from minitouch_bench.reporting.pages import image_uri, render_page
from minitouch_bench.reporting.report import USUAL, Report, Shown, build_report, find_videos
from minitouch_bench.reporting.run_tables import task_summary
from minitouch_bench.reporting.tables import Cell, Column, Row, Table, estimate_cell
from minitouch_bench.runs.run import Run

TEMPLATE = Path(__file__).parent / "templates" / "report.html.j2"

BESIDE_SUCCESS = ("episode_steps", "touch_interaction")
BESIDE_TOUCH = ("touched", "time_to_first_touch")
"""What a card shows beside the value that sums its task up."""


def table4_latex(report: Report) -> str:
    """Write Table 4 as LaTeX, ready for a paper."""
    header = report.sections[0].run.header
    caption = f"MiniTouch, protocol {header.protocol}, suite {header.plan.suite}, beside the paper."
    return table_latex(report.table4, caption)


TABLE_FORMATS: Mapping[str, Callable[[Report], str]] = MappingProxyType(
    {
        "md": lambda report: "\n".join(table_section(report.table4)[1:]) + "\n",
        "latex": table4_latex,
        "csv": table4_csv,
        "json": table4_json,
    }
)
"""How Table 4 is written as text, by the name of the format."""


def write_views(run: Run, directory: Path, videos: Sequence[Path] = ()) -> Report:
    """Write ``episodes.csv`` and ``report.html`` of a run; return what the page shows.

    Raises:
        RunDirectoryError: one cannot be written.
    """
    files.write_file(directory / files.EPISODES_FILE, episodes_csv(run.rows))
    return write_page([run], directory, videos)


def write_page(
    runs: Sequence[Run], directory: Path, videos: Sequence[Path] = (), shown: Shown = USUAL
) -> Report:
    """Write ``report.html`` of one or several runs; return what it shows.

    Raises:
        UsageError: see ``build_report``.
        RunDirectoryError: the file cannot be written.
    """
    report = build_report(runs, find_videos(videos, directory), shown)
    files.write_file(directory / files.REPORT_PAGE, to_html(report))
    return report


def to_html(report: Report) -> str:
    """Write a report as one self-contained page that opens offline."""
    return render_page(
        TEMPLATE,
        report=report,
        cards=tuple(report_card(report, task) for task in report.tasks),
        figures=report_figures(report),
        split_figures=split_figures(report),
        tones=tuple(series_tone(index) for index in range(len(report.sections))),
    )


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


def report_card(report: Report, task: str) -> Card:
    """Compose the card of a task."""
    named = ((section.name, task_summary(section.run, task)) for section in report.sections)
    runs = [(name, summary.estimates if summary else {}) for name, summary in named]
    return make_card(task, runs, image_uri(task))


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


def show_report(report: Report, console: Console) -> None:
    """Print the tables."""
    console.print(on_screen(report_blocks(report)))


def report_blocks(report: Report) -> Iterator[Block]:
    """Yield the tables with their notes; a table's blocks of columns come one after the other."""
    yield from (report.table4.block(group) for group, _ in report.table4.groups)
    yield from _notes(report.table4)
    for table in report.novel_shapes:
        for group, _ in table.groups:
            yield replace(table.block(group), title=f"{table.title}: {group}")
        yield from _notes(table)
    yield from _by_policy(report.diagnostics)
    yield from _notes(report.diagnostics)
    if any(section.faults for section in report.sections):
        yield Heading("Policy faults")
    yield from (line for section in report.sections for line in fault_lines(section))


def _notes(table: Table) -> Iterator[Block]:
    yield from map(NoteBlock, table.notes)
    yield ""


def _by_policy(table: Table) -> Iterator[Table]:
    """Turn the diagnostics on their side, a table per policy: metrics down, tasks across."""
    for policy in dict.fromkeys(row.heads[-1] for row in table.rows):
        rows = [row for row in table.rows if row.heads[-1] == policy]
        yield Table(
            title=f"{table.title}: {policy}",
            corner=("",),
            columns=tuple(Column(row.heads[0], is_text=True) for row in rows),
            rows=tuple(
                Row(
                    (f"{column.label} ({column.unit})" if column.unit else column.label,),
                    tuple(Cell(row.cells[index].text) for row in rows),
                )
                for index, column in enumerate(table.columns)
            ),
        )
