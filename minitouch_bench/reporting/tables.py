"""A table as data, and how a terminal, Markdown and CSV show it; a page has a macro.

A text for a terminal or for Markdown is a list of blocks: headings, lines, tables and notes.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

from rich.cells import cell_len
from rich.console import Console, Group, RenderableType
from rich.constrain import Constrain
from rich.padding import Padding
from rich.table import Table as RichTable
from rich.text import Text

from minitouch_bench.text import printable

ABSENT = "—"
"""Written where a value does not exist; 0 would be a claim."""


@dataclass(frozen=True)
class Cell:
    """A value as text.

    ``small`` is printed below or behind the value: its interval, or a mark. ``title`` says how
    both were made. A sort goes by ``sort_key``. A page draws ``gauge`` below. A value that
    ``is_best`` is bold, but not on a terminal.
    """

    text: str = ABSENT
    small: str = ""
    title: str = ""
    sort_key: float | None = None
    gauge: str = ""
    is_best: bool = False

    def __str__(self) -> str:
        return f"{self.text} {self.small}".rstrip()


@dataclass(frozen=True)
class Column:
    """A column: ``group`` names the block it belongs to, "" for none.

    ``is_text`` marks a column of words, which may be broken into lines, ``is_code`` one of
    commands to copy.
    """

    label: str
    group: str = ""
    unit: str = ""
    is_paper: bool = False
    is_text: bool = False
    is_code: bool = False


@dataclass(frozen=True)
class Row:
    """A row; ``heads`` are the cells that name it, ``unit`` what its values count."""

    heads: tuple[str, ...]
    cells: tuple[Cell, ...]
    unit: str = ""


@dataclass(frozen=True)
class Table:
    """A table ready to draw: ``corner`` names the row heads, ``notes`` are printed below.

    ``caption`` says what bold means.
    """

    title: str
    corner: tuple[str, ...]
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    caption: str = ""

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """The blocks of columns in order, each with its number of columns."""
        return tuple(Counter(column.group for column in self.columns).items())

    def block(self, group: str) -> "Table":
        """Return one block of columns, without the rows that have no value in it."""
        kept = [column.group == group for column in self.columns]
        rows = (replace(row, cells=tuple(compress(row.cells, kept))) for row in self.rows)
        filled = (row for row in rows if any(cell.text != ABSENT for cell in row.cells))
        columns = tuple(compress(self.columns, kept))
        return replace(self, title=group, columns=columns, rows=tuple(filled))


def make_columns(*labels: str, words: Sequence[str] = ()) -> tuple[Column, ...]:
    """Return columns of these labels; those that are in ``words`` are of text."""
    return tuple(Column(label, is_text=label in words) for label in labels)


def make_row(heads: str | tuple[str, ...], *cells: Cell | str | None) -> Row:
    """Return a row of cells and of texts; None is a value that does not exist."""
    heads = (heads,) if isinstance(heads, str) else heads
    return Row(
        heads, tuple(cell if isinstance(cell, Cell) else Cell(cell or ABSENT) for cell in cells)
    )


# Blocks, and the terminal


@dataclass(frozen=True)
class Heading:
    """The title of what follows."""

    text: str


@dataclass(frozen=True)
class NoteBlock:
    """A remark on how the values were made."""

    text: str


Block = Heading | NoteBlock | Table | str
"""A string is a line; on a page it is an item of a list. An empty one parts what is around it."""

NOTE_WIDTH = 120
"""Characters in a line of a remark, however wide the screen."""

PAGE_WIDTH = 10_000
"""Characters in a line of a text that no terminal shows: no table is cut."""

WORD_WIDTH, LEAST_WIDTH = 20, 4
"""Characters that a column of words keeps on a narrow, and on the narrowest screen."""

INDENT, GAP = 1, 2
"""Characters of a terminal before a table, and between two columns."""


def show(blocks: Iterable[Block], console: Console) -> None:
    """Print blocks. No number is cut on a narrow screen; text is never read as markup."""
    parts: list[RenderableType] = []
    for block in blocks:
        match block:
            case Heading():
                parts += [Text(), Text(block.text, style="bold underline")]
            case NoteBlock():
                parts.append(Constrain(Text(block.text, style="dim"), NOTE_WIDTH))
            case Table():
                drawn = _screen_tables(block, console.width - INDENT + GAP)  # no gap after the last
                parts += [Text(block.title, style="bold")]
                parts += [Padding(one, (0, 0, 0, INDENT), expand=False) for one in drawn]
            case _:
                parts.append(Text(block))
    console.print(Group(*parts), crop=False)


def as_text(blocks: Iterable[Block]) -> str:
    """Return what a terminal of PAGE_WIDTH shows, without its styles."""
    # A notebook would show by itself what is printed here, in addition to the returned text.
    console = Console(width=PAGE_WIDTH, file=io.StringIO(), record=True, force_jupyter=False)
    show(blocks, console)
    return "\n".join(line.rstrip() for line in console.export_text().splitlines())


@dataclass(frozen=True)
class _ScreenColumn:
    """A column of a terminal. On a narrow screen intervals go below their numbers."""

    column: Column
    cells: tuple[Cell, ...]

    @property
    def head(self) -> str:
        """Its name, and its unit below."""
        below = "(paper)" if self.column.is_paper else self.column.unit
        return f"{self.column.label}\n{below}".rstrip()

    @property
    def width(self) -> int:
        """Characters of its longest line, and of the gap to the next column."""
        return GAP + _longest((*self.head.splitlines(), *map(str, self.cells)))

    @property
    def least(self) -> int:
        """The same on a narrow screen."""
        words = self.head.split()
        numbers = [part for cell in self.cells for part in (cell.text, cell.small)]
        if self.column.is_text:
            words, numbers = [*words, *(word for part in numbers for word in part.split())], []
        return GAP + max(min(_longest(words), WORD_WIDTH), _longest(numbers))


def _longest(texts: Iterable[str]) -> int:
    return max(map(cell_len, texts), default=0)


def _screen_tables(table: Table, width: int) -> Iterator[RichTable]:
    """Yield a table; where its columns do not fit, in parts that have the same row heads."""
    heads = [
        _ScreenColumn(Column(label, is_text=True), tuple(Cell(row.heads[i]) for row in table.rows))
        for i, label in enumerate(table.corner)
    ]
    part: list[_ScreenColumn] = []
    for i, column in enumerate(table.columns):
        one = _ScreenColumn(column, tuple(row.cells[i] for row in table.rows))
        if part and sum(other.least for other in (*heads, *part, one)) > width:
            yield _draw([*heads, *part], width)
            part = []
        part.append(one)
    yield _draw([*heads, *part], width)


def _draw(columns: Sequence[_ScreenColumn], width: int) -> RichTable:
    drawn = RichTable(box=None, pad_edge=False)
    is_narrow = sum(column.width for column in columns) > width
    spare = width - sum(column.least for column in columns)
    for one in columns:
        taken = one.least if is_narrow else one.width
        if is_narrow and one.column.is_text:
            taken = max(GAP + LEAST_WIDTH, min(one.least + spare, one.width))
            spare -= taken - one.least
        drawn.add_column(
            Text(one.head, overflow="fold"),
            width=taken - GAP,
            justify="left" if one.column.is_text else "right",
            style="dim" if one.column.is_paper else "",
        )
    for cells in zip(*(one.cells for one in columns), strict=True):
        parts = (
            f"{cell.text}\n{cell.small}".rstrip() if is_narrow else str(cell) for cell in cells
        )
        drawn.add_row(*(Text(part, overflow="fold") for part in parts))
    return drawn


# Markdown, as GitHub reads it

_MARKDOWN = str.maketrans({mark: f"\\{mark}" for mark in "\\`*_{}[]<>#|~&$"})
_LIST_START = re.compile(r"^(\d*)([-+=.)])(?=\s|$)")


def escape_md(text: str) -> str:
    """Return the text so that Markdown shows it and does not read it as marks or HTML."""
    return _LIST_START.sub(r"\1\\\2", printable(text).translate(_MARKDOWN))


def code_span(text: str) -> str:
    """Return the text as a code span that no backtick inside can close."""
    plain = printable(text)
    longest = max((len(run) for run in re.findall("`+", plain)), default=0)
    fence, pad = "`" * (longest + 1), " " if longest else ""
    return f"{fence}{pad}{plain}{pad}{fence}"


def as_markdown(blocks: Iterable[Block]) -> list[str]:
    """Return the lines of a page, which a notebook shows too."""
    lines: list[str] = []
    for block in blocks:
        match block:
            case Heading():
                lines += ["", f"## {escape_md(block.text)}", ""]
            case NoteBlock():
                lines.append(f"- {escape_md(block.text)}")
            case Table():
                lines += ["", f"### {escape_md(block.title)}", "", *table_lines(block)]
            case _:
                lines.append(f"- {escape_md(block)}" if block else "")
    return lines


def table_lines(table: Table) -> list[str]:
    """Write a table; a block's name stands above each of its columns' names."""
    heads = [
        "<br>".join(escape_md(part) for part in (column.group, column.label, column.unit) if part)
        + (" (paper)" if column.is_paper else "")
        for column in table.columns
    ]
    ruler = ["---" if column.is_text else "---:" for column in table.columns]
    lines = [
        _markdown_row([*map(escape_md, table.corner), *heads]),
        _markdown_row([*["---"] * len(table.corner), *ruler]),
    ]
    for row in table.rows:
        first = [escape_md(head) for head in row.heads]
        if row.unit:
            first[-1] += f"<br>{escape_md(row.unit)}"
        cells = (
            code_span(str(cell)).replace("|", "\\|") if column.is_code else _markdown_cell(cell)
            for cell, column in zip(row.cells, table.columns, strict=True)
        )
        lines.append(_markdown_row([*first, *cells]))
    return lines


def _markdown_cell(cell: Cell) -> str:
    if not cell.is_best:
        return escape_md(str(cell))
    return f"**{escape_md(cell.text)}** {escape_md(cell.small)}".rstrip()


def _markdown_row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


# CSV

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
"""First characters that make a spreadsheet run a cell."""


def rows_csv(columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Write rows as CSV, the same on every machine.

    Numbers in the shortest form that reads back the same, "true" and "false", an empty cell for
    what does not exist. A text that a spreadsheet would run as a formula gets an apostrophe.
    """
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(map(_csv_cell, row) for row in rows)
    return written.getvalue()


def _csv_cell(value: Any) -> Any:
    """Return what the writer of CSV takes for a value; it writes nothing for None."""
    if not isinstance(value, str):
        return str(value).lower() if isinstance(value, bool) else value
    # The guard looks at the raw text too: a leading tab is gone once it is printable.
    plain = printable(value)
    is_formula = any(text.startswith(FORMULA_STARTS) for text in (value, plain))
    return f"'{plain}" if is_formula else plain
