"""Tables on a terminal, and those of a report."""

from collections.abc import Iterator
from dataclasses import replace

from rich.console import Console, Group, JustifyMethod, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from minitouch_bench.rendering.tables import Cell, Column, Row, Table
from minitouch_bench.reporting.labels import fault_lines
from minitouch_bench.reporting.report import Report

PAPER_WIDTH = 9
"""Characters in a column of the paper's values."""


def show_report(report: Report, console: Console) -> None:
    """Print the tables; the blocks of one stand below each other."""
    console.print(render_report(report))


def render_report(report: Report) -> RenderableType:
    """Return the report's tables as something Rich prints."""
    parts: list[RenderableType] = []
    parts += [draw_table(report.table4.block(group)) for group, _ in report.table4.groups]
    parts += [*_notes(report.table4), Text()]
    for table in report.tables_over_runs:
        parts += [draw_table(table), *_notes(table), Text()]
    for table in report.novel_shapes:
        for group, _ in table.groups:
            parts.append(draw_table(replace(table.block(group), title=f"{table.title}: {group}")))
        parts += [*_notes(table), Text()]
    parts += [draw_table(table) for table in _by_policy(report.diagnostics)]
    parts += _notes(report.diagnostics)
    if any(section.faults for section in report.sections):
        parts += [Text(), Text("Policy faults", style="bold red")]
    parts += [Text(line) for section in report.sections for line in fault_lines(section)]
    return Group(*parts)


def _notes(table: Table) -> list[Text]:
    """Return the notes below a table."""
    return [Text(note, style="dim") for note in table.notes]


def _by_policy(table: Table) -> Iterator[Table]:
    """Turn the diagnostics on their side, one table a policy: figures down, tasks across."""
    for policy in dict.fromkeys(row.heads[-1] for row in table.rows):
        rows = [row for row in table.rows if row.heads[-1] == policy]
        yield Table(
            title=f"{table.title}: {policy}",
            corner=("",),
            columns=tuple(Column(row.heads[0], is_text=True) for row in rows),
            rows=tuple(
                Row((_head(column),), tuple(Cell(row.cells[place].text) for row in rows))
                for place, column in enumerate(table.columns)
            ),
            notes=(),
        )


def _head(column: Column) -> str:
    """Name a figure with its unit."""
    return f"{column.label} ({column.unit})" if column.unit else column.label


def draw_table(table: Table) -> RichTable:
    """Draw a table; text is never read as markup."""
    drawn = RichTable(title=Text(table.title, style="bold"), title_justify="left", box=None)
    for head in table.corner:
        drawn.add_column(Text(head), no_wrap=True)
    for column in table.columns:
        style = "dim" if column.is_paper else ""
        head = f"{column.label} (paper)" if column.is_paper else column.label
        justify: JustifyMethod = "left" if column.is_text else "right"
        # On a narrow screen "(paper)" goes below the name, and leaves room for our intervals.
        width = PAPER_WIDTH if column.is_paper else None
        drawn.add_column(Text(head), justify=justify, style=style, overflow="fold", max_width=width)
    for row in table.rows:
        drawn.add_row(*map(Text, row.heads), *(Text(str(cell)) for cell in row.cells))
    return drawn
