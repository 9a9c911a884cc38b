"""Tables as Markdown."""

from minitouch_bench.rendering.markdown import WIDEST, table_section
from minitouch_bench.rendering.tables import ABSENT, Column, Table, make_row


def grouped(columns):
    """A table of two blocks of so many columns; the second block has one value."""
    labels = [Column(f"m{index}", group) for group in ("Pushing", "Opening") for index in columns]
    first = ["1"] * len(columns)
    return Table(
        "Table 4",
        ("Metric",),
        tuple(labels),
        (
            make_row("Success", *first, "2", *[ABSENT] * (len(columns) - 1)),
            make_row("Exploration", *first, *[ABSENT] * len(columns)),
        ),
        ("a note",),
    )


def test_a_table_that_fits_is_one():
    lines = table_section(grouped(range(WIDEST // 2)))
    assert sum(line.startswith("| ---") for line in lines) == 1
    assert lines[-1] == "- a note"


def test_a_wide_table_is_one_per_block_without_what_is_empty():
    lines = table_section(grouped(range(WIDEST // 2 + 1)))
    first, second = (line for line in lines if line.startswith("| Metric"))
    assert first.count("Pushing<br>m") == WIDEST // 2 + 1
    assert second == "| Metric | Opening<br>m0 |"
    assert lines.count("| Success | 2 |") == 1
    assert not any("Exploration | — |" in line for line in lines)
    assert lines.count("- a note") == 1
