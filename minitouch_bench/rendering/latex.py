r"""Tables in LaTeX, in the style of the packages booktabs and graphicx."""

from collections.abc import Iterable, Sequence

from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.tables import Column, Row, Table

PREAMBLE = r"% \usepackage{booktabs,graphicx}"

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
    }
)


def escape(text: str) -> str:
    """Return the text so that LaTeX prints it and runs none of it."""
    return printable(text).translate(_ESCAPES)


def table_source(table: Table, caption: str) -> str:
    """Write a table as a float across the page; intervals and units stand in a line below."""
    head = len(table.corner)
    lines = [
        PREAMBLE,
        r"\begin{table*}",
        r"  \centering",
        rf"  \caption{{{escape(caption)}}}",
        r"  \resizebox{\textwidth}{!}{%",
        rf"  \begin{{tabular}}{{{'l' * head}{''.join(map(_alignment, table.columns))}}}",
        r"    \toprule",
        *_group_lines(table, head),
        _line([*map(escape, table.corner), *(_heading(column) for column in table.columns)]),
        r"    \midrule",
        *(line for row in table.rows for line in _row_lines(row)),
        r"    \bottomrule",
        r"  \end{tabular}}",
        *(rf"  \par\footnotesize {escape(note)}" for note in table.notes),
        r"\end{table*}",
    ]
    return "\n".join(lines) + "\n"


def _alignment(column: Column) -> str:
    return "l" if column.is_text else "r"


def _group_lines(table: Table, head: int) -> Iterable[str]:
    """Write the names of the blocks of columns, each with a rule below it."""
    if not any(name for name, _ in table.groups):
        return
    cells, rules, first = [""] * head, [], head + 1
    for name, span in table.groups:
        cells.append(rf"\multicolumn{{{span}}}{{c}}{{{escape(name)}}}")
        rules.append(rf"\cmidrule(lr){{{first}-{first + span - 1}}}")
        first += span
    yield _line(cells)
    yield f"    {''.join(rules)}"


def _heading(column: Column) -> str:
    label = f"{column.label} ({column.unit})" if column.unit else column.label
    return rf"\textit{{{escape(label)}}}" if column.is_paper else escape(label)


def _row_lines(row: Row) -> Iterable[str]:
    """Write a row, and below it in small print what its values count and their intervals."""
    yield _line([*map(escape, row.heads), *(escape(cell.text) for cell in row.cells)])
    small = [*[""] * (len(row.heads) - 1), row.unit, *(cell.small for cell in row.cells)]
    if any(small):
        yield _line([rf"\scriptsize {escape(text)}" if text else "" for text in small])


def _line(cells: Sequence[str]) -> str:
    # A bracket at the start of a line would be read as an option of the \\ before it.
    return f"    {' & '.join(cells)} \\\\{{}}"
