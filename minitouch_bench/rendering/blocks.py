"""A text of headings, lines, tables and notes, as a screen and as Markdown show it."""

import io
from collections.abc import Iterable
from dataclasses import dataclass

from rich.console import Console, Group, JustifyMethod, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from minitouch_bench.rendering.markdown import escape, table_lines
from minitouch_bench.rendering.tables import Table

PAPER_WIDTH = 9
"""Characters of a terminal in a column of the paper's values."""

PAGE_WIDTH = 120
"""Characters in a line of a text that no terminal shows."""


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


def on_screen(blocks: Iterable[Block]) -> Group:
    """Return the blocks for a terminal; text is never read as markup."""
    return Group(*(part for block in blocks for part in _screen_parts(block)))


def as_text(blocks: Iterable[Block]) -> str:
    """Return what a terminal of PAGE_WIDTH shows, without its styles."""
    # A notebook would show by itself what is printed here, in addition to the returned text.
    console = Console(width=PAGE_WIDTH, file=io.StringIO(), record=True, force_jupyter=False)
    console.print(on_screen(blocks))
    lines = console.export_text().splitlines()
    return "\n".join(line.rstrip() for line in lines)


def _screen_parts(block: Block) -> tuple[RenderableType, ...]:
    match block:
        case Heading():
            return Text(), Text(block.text, style="bold underline")
        case NoteBlock():
            return (Text(block.text, style="dim"),)
        case Table():
            return (draw_table(block),)
    return (Text(block),)


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


def as_markdown(blocks: Iterable[Block]) -> list[str]:
    """Return the lines of a page."""
    lines: list[str] = []
    for block in blocks:
        match block:
            case Heading():
                lines += ["", f"## {escape(block.text)}", ""]
            case NoteBlock():
                lines.append(f"- {escape(block.text)}")
            case Table():
                lines += ["", f"### {escape(block.title)}", "", *table_lines(block)]
            case _:
                lines.append(f"- {escape(block)}" if block else "")
    return lines
