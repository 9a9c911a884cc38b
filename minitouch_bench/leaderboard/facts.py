"""What a board shows of a row beside its figures, declared at the type of the field.

``leaderboard.json`` has every field. The CSV and Markdown files, the site's tables and the
submission's page go over those with a ``Fact``: a new one needs no other code.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, get_type_hints


class Place(StrEnum):
    """Where a fact is shown, beside the list on the submission's page, which has all of them."""

    COLUMN = "column"
    """In the CSV and Markdown files, and in a column of the site's overall table."""

    NAME = "name"
    """In the CSV and Markdown files, and below the row's name in the site's overall table."""

    PAGE = "page"
    """Nowhere else."""


def in_words(value: object) -> str:
    """Write a fact for people; "" where there is none."""
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value or "")


def amount(number: int) -> str:
    """Write a large number short: 2 M, 1.5 k; one that is not exact with three digits."""
    rounded = float(f"{number:.3g}")
    for size, unit in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rounded >= size:
            return f"{rounded / size:.3g}\u202f{unit}"
    return str(number) if number else "none"


@dataclass(frozen=True)
class Fact:
    """How a field of a row is shown, given in the field's ``Annotated`` type.

    ``write`` gives its text for people, "" where there is nothing to say. The CSV file has the
    value itself: the words of a tuple with spaces between, or how many numbers it has.
    """

    label: str
    place: Place = Place.PAGE
    unit: str = ""
    write: Callable[[Any], str] = in_words
    is_text: bool = True
    is_link: bool = False


def facts_of(kind: type) -> Mapping[str, Fact]:
    """Return the facts of a record by the names of their fields, in order."""
    return {
        name: note
        for name, hint in get_type_hints(kind, include_extras=True).items()
        for note in getattr(hint, "__metadata__", ())
        if isinstance(note, Fact)
    }
