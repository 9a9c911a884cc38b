"""Tables and texts as a terminal, Markdown and LaTeX show them.

A text is a list of blocks: headings, lines, tables and notes.
"""

import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich.console import Console, Group, JustifyMethod, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from minitouch_bench.errors import printable
from minitouch_bench.reporting.tables import Column, Row, Table

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
                lines += ["", f"## {escape_md(block.text)}", ""]
            case NoteBlock():
                lines.append(f"- {escape_md(block.text)}")
            case Table():
                lines += ["", f"### {escape_md(block.title)}", "", *table_lines(block)]
            case _:
                lines.append(f"- {escape_md(block)}" if block else "")
    return lines


# Markdown, as GitHub reads it

WIDEST = 20
"""Columns that fit beside each other."""

_MARKDOWN = str.maketrans({mark: f"\\{mark}" for mark in "\\`*_{}[]<>#|~&$"})
_LIST_START = re.compile(r"^(\d*)([-+=.)])(?=\s|$)")


def escape_md(text: str) -> str:
    """Return the text so that Markdown shows it and does not read it as marks or HTML."""
    return _LIST_START.sub(r"\1\\\2", printable(text).translate(_MARKDOWN))


def code_span(text: str) -> str:
    """Return the text as a code span that no backtick inside can close."""
    plain = printable(text)
    longest = max((len(run) for run in re.findall("`+", plain)), default=0)
    fence = "`" * (longest + 1)
    pad = " " if longest else ""
    return f"{fence}{pad}{plain}{pad}{fence}"


def table_lines(table: Table) -> list[str]:
    """Write a table; a block's name stands above each of its columns' names."""
    heads = [
        "<br>".join(escape_md(part) for part in (column.group, column.label, column.unit) if part)
        + (" (paper)" if column.is_paper else "")
        for column in table.columns
    ]
    ruler = ["---"] * len(table.corner)
    ruler += ["---" if column.is_text else "---:" for column in table.columns]
    lines = [_markdown_row([*map(escape_md, table.corner), *heads]), _markdown_row(ruler)]
    for row in table.rows:
        first = [escape_md(head) for head in row.heads]
        if row.unit:
            first[-1] += f"<br>{escape_md(row.unit)}"
        cells = (
            code_span(str(cell)).replace("|", "\\|") if column.is_code else escape_md(str(cell))
            for cell, column in zip(row.cells, table.columns, strict=True)
        )
        lines.append(_markdown_row([*first, *cells]))
    return lines


def table_section(table: Table) -> list[str]:
    """Write a table below its title, and its notes below it; of a wide one a table per block."""
    notes = [f"- {escape_md(note)}" for note in table.notes]
    blocks = [table]
    if len(table.columns) > WIDEST:
        blocks = [table.block(group).filled_columns() for group, _ in table.groups]
    lines = [line for block in blocks for line in ["", *table_lines(block)]]
    return ["", f"## {escape_md(table.title)}", *lines, *(["", *notes] if notes else [])]


def _markdown_row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


# LaTeX, in the style of the package booktabs

PREAMBLE = r"% \usepackage{booktabs,graphicx}"
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
    lines = [
        PREAMBLE,
        r"\begin{table}",
        r"  \centering\small\setlength{\tabcolsep}{4pt}",
        rf"  \caption{{{escape_tex(caption)}}}",
        f"  {SHRINK}",
        rf"  \begin{{tabular}}{{{'l' * len(table.corner)}{'r' * len(columns)}}}",
        r"    \toprule",
        _latex_row([*map(escape_tex, table.corner), *map(_latex_heading, columns)]),
        _latex_row(_latex_small([*[""] * len(table.corner), *map(_latex_remark, columns)])),
        *(line for block in blocks for line in _latex_block(block, width)),
        r"    \bottomrule",
        r"  \end{tabular}}",
        *(
            rf"  \par\parbox{{\linewidth}}{{\footnotesize {escape_tex(note)}}}"
            for note in table.notes
        ),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _latex_block(block: Table, width: int) -> Iterable[str]:
    yield r"    \midrule"
    if block.title:
        yield rf"    \multicolumn{{{width}}}{{l}}{{\textbf{{{escape_tex(block.title)}}}}} \\"
    for row in block.rows:
        yield from _latex_lines(row)


def _latex_heading(column: Column) -> str:
    return (
        rf"\textit{{{escape_tex(column.label)}}}" if column.is_paper else escape_tex(column.label)
    )


def _latex_remark(column: Column) -> str:
    return "paper" if column.is_paper else column.unit


def _latex_lines(row: Row) -> Iterable[str]:
    """Write a row, and below it in small print what its values count and their intervals."""
    yield _latex_row([*map(escape_tex, row.heads), *(escape_tex(cell.text) for cell in row.cells)])
    small = [*[""] * (len(row.heads) - 1), row.unit, *(cell.small for cell in row.cells)]
    if any(small):
        yield _latex_row(_latex_small(small))


def _latex_small(texts: Sequence[str]) -> list[str]:
    return [rf"\scriptsize {escape_tex(text)}" if text else "" for text in texts]


def _latex_row(cells: Sequence[str]) -> str:
    line = " & ".join(cells)
    # A bracket at the start of a line would be read as an option of the \\ before it.
    return f"    {'{}' if line.startswith('[') else ''}{line} \\\\"
