"""How a field of a board's row is shown, declared at the type of the field.

``leaderboard.json`` has every field. The CSV and Markdown files, the site's tables and the
submission's page go over the fields with a ``ColumnSpec``: a new one needs no other code.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_type_hints


def in_words(value: object) -> str:
    """Write a value for people; "" where there is none."""
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value or "")


def amount(number: int) -> str:
    """Write a large number short: 2 M, 1.5 k; one that is not exact with three digits."""
    rounded = float(f"{number:.3g}")
    for size, unit in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rounded >= size:
            return f"{rounded / size:.3g}\u202f{unit}"
    return str(number) if number else "none"


@dataclass(frozen=True)
class ColumnSpec:
    """How a field of a row is shown, given in the field's ``Annotated`` type.

    Args:
        label: Heading of the column.
        place: Where the field is shown beside the list on the submission's page, which has all
            of them. "column": in the CSV and Markdown files, and in a column of the site's
            overall table. "name": in these files, and below the row's name in that table.
            "page": nowhere else.
        unit: What a number counts.
        write: Gives the text for people, "" where there is nothing to say. The CSV file has the
            value itself: the words of a tuple with spaces between, or how many numbers it has.
        is_text: Whether the column has words.
        is_link: Whether the value is an address.
    """

    label: str
    place: Literal["column", "name", "page"] = "page"
    unit: str = ""
    write: Callable[[Any], str] = in_words
    is_text: bool = True
    is_link: bool = False


def columns_of(kind: type) -> Mapping[str, ColumnSpec]:
    """Return the columns of a record by the names of their fields, in order."""
    return {
        name: note
        for name, hint in get_type_hints(kind, include_extras=True).items()
        for note in getattr(hint, "__metadata__", ())
        if isinstance(note, ColumnSpec)
    }
