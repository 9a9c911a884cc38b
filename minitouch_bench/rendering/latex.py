"""Tables in LaTeX, in the style of the package booktabs."""

from collections.abc import Iterable, Sequence

from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.tables import Column, Row, Table

PREAMBLE = r"% \usepackage{booktabs,graphicx}"
SHRINK = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"
"""Makes what follows as narrow as the page, where it is wider."""

_ESCAPES = str.maketrans(
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


def escape(text: str) -> str:
    """Return the text so that LaTeX prints it and runs none of it."""
    return printable(text).translate(_ESCAPES)


def table_source(table: Table, caption: str) -> str:
    """Write a table as a float, its blocks below each other so that it fits a page.

    The blocks must have the same columns. Intervals and units stand in a line of small print.
    """
    blocks = [table.block(group) for group, _ in table.groups]
    columns = blocks[0].columns if blocks else ()
    width = len(table.corner) + len(columns)
    lines = [
        PREAMBLE,
        r"\begin{table}",
        r"  \centering\small\setlength{\tabcolsep}{4pt}",
        rf"  \caption{{{escape(caption)}}}",
        f"  {SHRINK}",
        rf"  \begin{{tabular}}{{{'l' * len(table.corner)}{'r' * len(columns)}}}",
        r"    \toprule",
        _line([*map(escape, table.corner), *map(_heading, columns)]),
        _line(_small([*[""] * len(table.corner), *map(_remark, columns)])),
        *(line for block in blocks for line in _block_lines(block, width)),
        r"    \bottomrule",
        r"  \end{tabular}}",
        *(rf"  \par\parbox{{\linewidth}}{{\footnotesize {escape(note)}}}" for note in table.notes),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _block_lines(block: Table, width: int) -> Iterable[str]:
    yield r"    \midrule"
    if block.title:
        yield rf"    \multicolumn{{{width}}}{{l}}{{\textbf{{{escape(block.title)}}}}} \\"
    for row in block.rows:
        yield from _row_lines(row)


def _heading(column: Column) -> str:
    return rf"\textit{{{escape(column.label)}}}" if column.is_paper else escape(column.label)


def _remark(column: Column) -> str:
    return "paper" if column.is_paper else column.unit


def _row_lines(row: Row) -> Iterable[str]:
    """Write a row, and below it in small print what its values count and their intervals."""
    yield _line([*map(escape, row.heads), *(escape(cell.text) for cell in row.cells)])
    small = [*[""] * (len(row.heads) - 1), row.unit, *(cell.small for cell in row.cells)]
    if any(small):
        yield _line(_small(small))


def _small(texts: Sequence[str]) -> list[str]:
    return [rf"\scriptsize {escape(text)}" if text else "" for text in texts]


def _line(cells: Sequence[str]) -> str:
    line = " & ".join(cells)
    # A bracket at the start of a line would be read as an option of the \\ before it.
    return f"    {'{}' if line.startswith('[') else ''}{line} \\\\"
