"""Tables on a terminal."""

from rich.console import JustifyMethod
from rich.table import Table as RichTable
from rich.text import Text

from minitouch_bench.rendering.tables import Table

PAPER_WIDTH = 9
"""Characters in a column of the paper's values."""


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
