"""A report in its three forms: ``report.md``, the page ``report.html``, and on a terminal."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import Estimate
from minitouch_bench.rendering.blocks import Block, Heading, NoteBlock, on_screen
from minitouch_bench.rendering.markdown import code_span, escape, table_section
from minitouch_bench.rendering.pages import image_uri, render_page
from minitouch_bench.rendering.palette import series_tone
from minitouch_bench.rendering.tables import Cell, Column, Row, Table, estimate_cell
from minitouch_bench.reporting.figures import report_figures, split_figures
from minitouch_bench.reporting.labels import RunSection, fault_lines, task_title
from minitouch_bench.reporting.paper import PAPER_METHODS, paper_value
from minitouch_bench.reporting.report import Report
from minitouch_bench.reporting.tables import task_summary

TEMPLATE = Path(__file__).parent / "templates" / "report.html.j2"

BESIDE_SUCCESS = ("episode_steps", "touch_interaction")
BESIDE_TOUCH = ("touched", "time_to_first_touch")
"""What a card shows beside the value that sums its task up."""


def to_markdown(report: Report) -> str:
    """Write a report as Markdown."""
    parts = [f"# {escape(report.title)}", ""]
    for section in report.sections:
        parts += _headline(section)
    for table in (
        report.table4,
        *report.over_runs.tables,
        *report.novel_shapes,
        report.diagnostics,
    ):
        parts += table_section(table)
    if any(section.faults for section in report.sections):
        parts += ["", "## Policy faults", ""]
        for section in report.sections:
            parts += [f"- {escape(line)}" for line in fault_lines(section)]
    parts += ["", "## What was run"]
    for section in report.sections:
        parts += ["", *_facts(section)]
    if report.videos:
        parts += ["", "## Videos", ""]
        parts += [f"- [{escape(video.caption)}](<{video.address}>)" for video in report.videos]
    return "\n".join(parts) + "\n"


def _headline(section: RunSection) -> list[str]:
    header = section.run.header
    kind = "official" if header.official else "unofficial"
    lines = [
        f"**{escape(section.name)}**: suite {escape(header.plan.suite)}, {kind}, "
        f"protocol {escape(header.protocol)} ({code_span(header.protocol_digest[:12])})"
    ]
    lines += [f"> {escape(label)}" for label in section.labels]
    return [lines[0], "", *(f"{line}  " for line in lines[1:]), ""]


def _facts(section: RunSection) -> list[str]:
    header, environment = section.run.header, section.run.environment
    packages = ", ".join(f"{name} {version}" for name, version in environment.packages.items())
    machine = ", ".join(f"{key}: {value}" for key, value in environment.machine.items())
    policy, limits = header.policy, header.plan.limits
    facts = {
        "Policy": f"{escape(policy.name)} ({escape(policy.kind)}), {code_span(policy.source)}",
        "Policy digest": code_span(policy.digest) if policy.digest else "built in",
        "Protocol": f"{escape(header.protocol)}, {code_span(header.protocol_digest)}",
        "Suite": f"{escape(header.plan.suite)}, seed {header.plan.seed}, {section.episodes}",
        "Isolation": f"{escape(header.isolation)}, {limits.act_timeout_s:g} s per action",
        "Packages": escape(packages),
        "Machine": escape(machine),
        "Started": f"{escape(environment.started)}, {environment.wall_s:.0f} s, "
        f"{environment.workers} workers",
        "Repeat it": code_span(section.command),
    }
    return [f"**{escape(section.name)}**", "", *(f"- {k}: {v}" for k, v in facts.items() if v)]


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
    for table in report.over_runs.tables:
        yield table
        yield from _notes(table)
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
