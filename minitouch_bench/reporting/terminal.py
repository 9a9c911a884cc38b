"""The tables of a report on a terminal."""

from collections.abc import Iterator
from dataclasses import replace

from rich.console import Console, Group, RenderableType
from rich.text import Text

from minitouch_bench.rendering.tables import Cell, Column, Row, Table
from minitouch_bench.rendering.terminal import draw_table
from minitouch_bench.reporting.report import Report


def show_report(report: Report, console: Console) -> None:
    """Print the tables; the blocks of one stand below each other."""
    console.print(render_report(report))


def render_report(report: Report) -> RenderableType:
    """Return the report's tables as something Rich prints."""
    parts: list[RenderableType] = []
    parts += [draw_table(report.table4.block(group)) for group, _ in report.table4.groups]
    parts += [*_notes(report.table4), Text()]
    for table in report.novel_shapes:
        for group, _ in table.groups:
            parts.append(draw_table(replace(table.block(group), title=f"{table.title}: {group}")))
        parts += [*_notes(table), Text()]
    parts += [draw_table(table) for table in _by_policy(report.diagnostics)]
    parts += _notes(report.diagnostics)
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
