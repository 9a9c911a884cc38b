"""Text and tables in GitHub's Markdown."""

import re
from collections.abc import Iterable

from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.tables import Table

WIDEST = 20
"""Columns that fit beside each other."""

_SPECIAL = str.maketrans({mark: f"\\{mark}" for mark in "\\`*_{}[]<>#|~&$"})
_LIST_START = re.compile(r"^(\d*)([-+=.)])(?=\s|$)")


def escape(text: str) -> str:
    """Return the text so that Markdown shows it and does not read it as marks or HTML."""
    return _LIST_START.sub(r"\1\\\2", printable(text).translate(_SPECIAL))


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
        "<br>".join(escape(part) for part in (column.group, column.label, column.unit) if part)
        + (" (paper)" if column.is_paper else "")
        for column in table.columns
    ]
    ruler = ["---"] * len(table.corner)
    ruler += ["---" if column.is_text else "---:" for column in table.columns]
    lines = [_line([*map(escape, table.corner), *heads]), _line(ruler)]
    for row in table.rows:
        first = [escape(head) for head in row.heads]
        if row.unit:
            first[-1] += f"<br>{escape(row.unit)}"
        cells = (
            code_span(str(cell)).replace("|", "\\|") if column.is_code else escape(str(cell))
            for cell, column in zip(row.cells, table.columns, strict=True)
        )
        lines.append(_line([*first, *cells]))
    return lines


def table_section(table: Table) -> list[str]:
    """Write a table below its title, and its notes below it; of a wide one a table per block."""
    notes = [f"- {escape(note)}" for note in table.notes]
    blocks = [table]
    if len(table.columns) > WIDEST:
        blocks = [table.block(group).filled_columns() for group, _ in table.groups]
    lines = [line for block in blocks for line in ["", *table_lines(block)]]
    return ["", f"## {escape(table.title)}", *lines, *(["", *notes] if notes else [])]


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
