"""A report of one or several runs as data, and in its forms.

The forms are the page ``report.html``, the tables of a terminal, and Table 4 as Markdown, LaTeX,
CSV and JSON.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import combinations, product
from pathlib import Path
from types import MappingProxyType
from typing import Any

from markupsafe import Markup
from rich.console import Console

from minitouch_bench import files
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import EPISODE_COLUMNS, TABLE4_METRICS, episode_row
from minitouch_bench.reporting import labels, pages, report_tables, tables
from minitouch_bench.reporting.charts import Figure
from minitouch_bench.reporting.figures import report_figures
from minitouch_bench.reporting.maps import MappedTask, start_figure
from minitouch_bench.reporting.tables import Block, Cell, Table
from minitouch_bench.runs.plan import first_of
from minitouch_bench.runs.run import Run
from minitouch_bench.text import numbered, printable


@dataclass(frozen=True)
class Report:
    """What every form of a report shows, ``with_paper`` beside the paper's values.

    ``metrics``: the rows of Table 4. ``novel_shapes``: the gaps and the families, empty where no
    run has both splits. ``episodes``: what the page's browser shows. ``videos``: captions by
    address, relative to the report.
    """

    tasks: tuple[str, ...]
    metrics: tuple[str, ...]
    sections: tuple[labels.RunSection, ...]
    table4: Table
    diagnostics: Table
    novel_shapes: tuple[Table, ...]
    episodes: Markup
    videos: Mapping[str, str]
    with_paper: bool = True


def build_report(
    runs: Sequence[Run],
    videos: Mapping[str, str] = MappingProxyType({}),
    *,
    names: Sequence[str] | None = None,
    tasks: Sequence[str] = (),
    metrics: Sequence[str] = (),
    directory: Path | None = None,
    viewers: Mapping[str, Path] = MappingProxyType({}),
    with_paper: bool = True,
) -> Report:
    """Compose the report of one or several runs.

    ``directory``: where its page will be written. ``viewers``: the pages of episodes of a single
    run that this process wrote, by episode.

    ``names``: what the runs are called, by default by their policies. ``tasks`` and ``metrics``:
    those of Table 4, () for the usual ones. ``with_paper``: beside the paper's values, unless a run
    is in the dark.

    Raises:
        UsageError: runs of which a task was played by other rules; names that do not fit
            the runs; a task that no run has, or a metric that does not exist.
    """
    for first, other in combinations(runs, 2):
        if differing := first.header.rules_differ(other.header):
            raise UsageError(
                f"{_protocol_of(first)} and {_protocol_of(other)} cannot be in one table: "
                f"the rules of {', '.join(differing)} differ"
            )
    with_paper = with_paper and not any(map(labels.is_dark, runs))  # whose light was on
    sections, is_selection = labels.describe_runs(runs, names), bool(tasks or metrics)
    tasks = _chosen("task", tasks, labels.tasks_in_order(runs))
    metrics = _chosen("metric", metrics, tuple(METRICS)) if metrics else TABLE4_METRICS
    table4 = report_tables.table4(sections, tasks, metrics, with_paper=with_paper)
    if is_selection and not table4.columns:
        raise UsageError("no run has a value of these metrics in these tasks")
    return Report(
        tasks=tasks,
        metrics=metrics,
        sections=sections,
        table4=table4,
        diagnostics=report_tables.diagnostics(sections, tasks),
        novel_shapes=report_tables.novel_shapes(sections, tasks),
        episodes=pages.browser_data(
            [_browsed(section, directory, viewers) for section in sections], tasks
        ),
        videos=videos,
        with_paper=with_paper,
    )


def _browsed(
    section: labels.RunSection, page: Path | None, viewers: Mapping[str, Path]
) -> pages.BrowsedRun:
    run, there = section.run, section.run.directory
    if page is None or there is None:
        return pages.BrowsedRun(section.name, run)
    if os.path.lexists(there / files.PACKED_RUN_FILE):
        evaluate = labels.reproduce_command(replace(run.header, exploration=None))
        return pages.BrowsedRun(section.name, replace(run, exploration_rows=()), evaluate=evaluate)
    known = {key: pages.relative_address(path, page) for key, path in viewers.items()}
    return pages.BrowsedRun(section.name, run, pages.relative_address(there, page), known)


def _protocol_of(run: Run) -> str:
    header = run.header
    rules = f"{header.protocol}, {header.protocol_digest[:12]}, suite {run.plan.suite}"
    return f"'{printable(run.place)}' ({rules})"


def _chosen(what: str, asked: Sequence[str], known: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names asked for, in the order of the known ones; all where none is asked for."""
    if unknown := [name for name in asked if name not in known]:
        raise UsageError(f"no {what} '{unknown[0]}' in these runs; there are {', '.join(known)}")
    return tuple(name for name in known if name in asked) if asked else known


# Pages


def write_views(
    run: Run, directory: Path, viewers: Mapping[str, Path] = MappingProxyType({})
) -> None:
    """Write ``episodes.csv`` and ``report.html`` of a run, with the videos in its directory.

    ``viewers``: see ``build_report``.

    Raises:
        RunDirectoryError: one cannot be written.
    """
    rows = tables.rows_csv(EPISODE_COLUMNS, map(episode_row, run.rows))
    files.write_file(directory / files.EPISODES_FILE, rows)
    videos = find_videos(files.list_videos(directory), directory)
    report = build_report([run], videos, directory=directory, viewers=viewers)
    write_page(report, directory)


def write_page(report: Report, directory: Path) -> None:
    """Write ``report.html``.

    Raises:
        RunDirectoryError: it cannot be written.
    """
    files.write_file(directory / files.REPORT_PAGE, to_html(report))


def find_videos(videos: Sequence[Path], directory: Path) -> Mapping[str, str]:
    """Return the captions of video files by their addresses in a report in ``directory``."""
    return {
        pages.relative_address(file, directory): printable(file.stem.replace("_", " "))
        for file in sorted(videos)
    }


def to_html(report: Report) -> str:
    """Write a report as one self-contained page that opens offline."""
    return pages.render_page(
        pages.TEMPLATES / "report.html.j2",
        scripts=("theme.js", "episodes.js"),
        report=report,
        cards=tuple(report_card(report, task) for task in report.tasks),
        figures=(start_map(report), *report_figures(report.sections, report.tasks)),
    )


def start_map(report: Report) -> Figure:
    """Draw where the episodes of each task and run begin and how they end."""
    is_single = len(report.sections) == 1
    return start_figure(
        [
            MappedTask(
                task,
                labels.task_title(task) + ("" if is_single else f": {section.name}"),
                [[row for row in section.run.rows if row.task == task]],
                f"{index} {task}",
            )
            for task in report.tasks
            for index, section in enumerate(report.sections)
        ]
    )


def report_card(report: Report, task: str) -> pages.Card:
    """Compose the card of a task."""
    runs = []
    for section in report.sections:
        summary = report_tables.task_summary(section.run, task)
        runs.append((section.name, summary.estimates if summary else {}))
    return pages.make_card(task, runs, pages.image_uri(task), with_paper=report.with_paper)


def view_directory(run: Path) -> Path:
    """Return where reports and videos of a finished run are written: its own directory.

    The results of a leaderboard's row stay as they are: the views of ``results/NAME/...`` are
    written to ``reports/NAME/...`` in the working directory.
    """
    if not os.path.lexists(run / files.PACKED_RUN_FILE):
        return run
    return files.REPORTS.joinpath(*run.resolve().parts[-3:])


# The terminal


SHOWN_EPISODES = 12
"""Episodes named for one fault; a policy that always fails would fill the screen."""


def show_report(report: Report, console: Console, *, diagnostics: bool = False) -> None:
    """Print the tables, ``diagnostics`` among them if asked for."""
    tables.show(report_blocks(report, diagnostics=diagnostics), console)


def report_blocks(report: Report, *, diagnostics: bool = False) -> Iterator[Block]:
    """Yield the tables with their notes; a table's blocks of columns come one after the other."""
    yield from (report.table4.block(group) for group, _ in report.table4.groups)
    yield from _notes(report.table4)
    for table in report.novel_shapes:
        yield table
        yield from _notes(table)
    if diagnostics:
        yield report.diagnostics
        yield from _notes(report.diagnostics)
    if any(section.faults for section in report.sections):
        yield tables.Heading("Policy faults")
    for section in report.sections:
        for text, episodes in section.faults.items():
            times = numbered(len(episodes), "episode")
            yield f"{section.name}: {text} ({times}: {first_of(episodes, SHOWN_EPISODES)})"


def _notes(table: Table) -> Iterator[Block]:
    yield from map(tables.NoteBlock, table.notes)
    yield ""


# Table 4 as text

TABLE4_COLUMNS = (
    "policy", "task", "metric", "value", "low", "high", "count", "method", "source"
)  # fmt: skip


def table4_markdown(report: Report) -> str:
    """Write Table 4 as Markdown."""
    table = report.table4
    notes = [f"- {tables.escape_md(note)}" for note in (table.caption, *table.notes) if note]
    lines = [f"## {tables.escape_md(table.title)}", "", *tables.table_lines(table), "", *notes]
    return "\n".join(lines) + "\n"


def table4_latex(report: Report) -> str:
    """Write Table 4 as LaTeX, ready for a paper."""
    protocol = report.sections[0].run.header.protocol
    suites = labels.listed([*dict.fromkeys(one.run.plan.suite for one in report.sections)])
    beside = ", beside the paper" if any(c.is_paper for c in report.table4.columns) else ""
    caption = f"MiniTouch, protocol {protocol}, suite {suites}{beside}."
    return table_latex(report.table4, f"{caption} {report.table4.caption}".rstrip())


def table4_csv(report: Report) -> str:
    """Write Table 4 in long form."""
    return tables.rows_csv(TABLE4_COLUMNS, _table4_rows(report))


def table4_json(report: Report) -> str:
    """Write Table 4 in long form, a list of objects."""
    rows = [dict(zip(TABLE4_COLUMNS, row, strict=True)) for row in _table4_rows(report)]
    return json.dumps(rows, indent=1, ensure_ascii=False) + "\n"


TABLE_FORMATS: Mapping[str, Callable[[Report], str]] = {
    "md": table4_markdown,
    "latex": table4_latex,
    "csv": table4_csv,
    "json": table4_json,
}
"""How Table 4 is written as text, by the name of the format."""


def _table4_rows(report: Report) -> Iterator[tuple[Any, ...]]:
    """Yield the values of Table 4, as ``TABLE4_COLUMNS``; those that do not exist have no row.

    ``source`` carries a run's labels, and what must be known of the paper's values.
    """
    for task, metric in product(report.tasks, report.metrics):
        for section in report.sections:
            known = "; ".join(section.labels)
            if estimate := report_tables.find_estimate(section.run, task, metric):
                source = f"run ({known})" if known else "run"
                yield (section.name, task, metric, *astuple(estimate), source)
        for method in labels.PAPER_METHODS if report.with_paper else ():
            if printed := labels.paper_value(task, metric, method):
                is_other = metric in labels.METRICS_OF_UNKNOWN_UNIT
                known = f"{labels.OTHER_UNIT}, {labels.CAVEAT}" if is_other else labels.CAVEAT
                source = f"paper ({known})"
                yield (method, task, metric, float(printed), None, None, None, "", source)


# LaTeX, in the style of the package booktabs

LATEX_HEAD = r"""% \usepackage{booktabs,graphicx}
\begin{table}
  \centering\small\setlength{\tabcolsep}{4pt}"""
SHRINK = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"
"""Makes what follows as narrow as the page, where it is wider."""

_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        **{character: f"\\{character}" for character in "&%$#_{}"},
        "\u2014": "---",
        "\u2191": r"$\uparrow$",
        "\u2193": r"$\downarrow$",
        "\u2020": r"\textdagger{}",
        "\u00b2": r"\textsuperscript{2}",
        "\u2264": r"$\leq$",
        "\u2265": r"$\geq$",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
    }
)


def escape_tex(text: str) -> str:
    """Return the text so that LaTeX prints it and runs none of it."""
    return printable(text).translate(_LATEX)


def table_latex(table: Table, caption: str) -> str:
    """Write a table as a float, its blocks below each other so that it fits a page.

    The blocks must have the same columns. Intervals and units are printed on a line of small print.
    """
    blocks = [table.block(group) for group, _ in table.groups]
    columns = blocks[0].columns if blocks else ()
    width = len(table.corner) + len(columns)
    names = [(r"\textit{%s}" if c.is_paper else "%s") % escape_tex(c.label) for c in columns]
    units = ["paper" if column.is_paper else column.unit for column in columns]
    lines = [
        LATEX_HEAD,
        rf"  \caption{{{escape_tex(caption)}}}",
        f"  {SHRINK}",
        rf"  \begin{{tabular}}{{{'l' * len(table.corner)}{'r' * len(columns)}}}",
        r"    \toprule",
        _latex_row([*map(escape_tex, table.corner), *names]),
        *([_latex_small([*[""] * len(table.corner), *units])] if any(units) else []),
    ]
    for block in blocks:
        lines.append(r"    \midrule")
        if block.title:
            name = rf"\textbf{{{escape_tex(block.title)}}}"
            lines.append(rf"    \multicolumn{{{width}}}{{l}}{{{name}}} \\")
        for row in block.rows:
            lines.append(_latex_row((*map(escape_tex, row.heads), *map(_latex_cell, row.cells))))
            small = [*[""] * (len(row.heads) - 1), row.unit, *(cell.small for cell in row.cells)]
            if any(small):
                lines.append(_latex_small(small))
    lines += [r"    \bottomrule", r"  \end{tabular}}"]
    lines += [rf"  \par\parbox{{\linewidth}}{{\footnotesize {escape_tex(n)}}}" for n in table.notes]
    return "\n".join([*lines, r"\end{table}", ""])


def _latex_cell(cell: Cell) -> str:
    text = escape_tex(cell.text)
    return rf"\textbf{{{text}}}" if cell.is_best else text


def _latex_small(texts: Sequence[str]) -> str:
    return _latex_row(rf"\scriptsize {escape_tex(text)}" if text else "" for text in texts)


def _latex_row(cells: Iterable[str]) -> str:
    line = " & ".join(cells)
    # A bracket at the start of a line would be read as an option of the \\ before it.
    return f"    {'{}' if line.startswith('[') else ''}{line} \\\\"
