"""What was recorded beside what was found, as a list of differences."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from minitouch_bench.rendering.escaping import printable

SHOWN_CHARACTERS = 60

ROUNDING = 1e-9
"""Relative difference of an estimate that another processor's arithmetic explains."""


@dataclass(frozen=True)
class Difference:
    """One thing that is not as recorded: where it stands, and what is wrong with it."""

    place: str
    what: str

    def __str__(self) -> str:
        return f"{printable(self.place)}: {printable(self.what)}"


def compare_values(
    place: str, recorded: Any, found: Any, tolerance: float = 0.0
) -> Iterator[Difference]:
    """Walk through two JSON values and yield each place where they differ.

    Floats may differ by the relative ``tolerance``: 0 compares them bit for bit.
    """
    if isinstance(recorded, Mapping) and isinstance(found, Mapping):
        for key in dict.fromkeys([*recorded, *found]):
            inner = f"{place}.{key}" if place else str(key)
            if key not in recorded or key not in found:
                yield Difference(inner, "missing" if key in found else "should not be there")
            else:
                yield from compare_values(inner, recorded[key], found[key], tolerance)
    elif _is_list(recorded) and _is_list(found):
        if len(recorded) != len(found):
            yield Difference(place, f"{len(recorded)} entries recorded, {len(found)} found")
        else:
            for index, pair in enumerate(zip(recorded, found, strict=True)):
                yield from compare_values(f"{place}[{index}]", *pair, tolerance)
    elif not _equal(recorded, found, tolerance):
        yield Difference(place, f"{_shown(recorded)} recorded, {_shown(found)} found")


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _equal(recorded: Any, found: Any, tolerance: float) -> bool:
    """Compare two plain values; 1 and 1.0 are the same JSON number, 1 and true are not."""
    if isinstance(recorded, bool) or isinstance(found, bool):
        return recorded is found
    if isinstance(recorded, float) and isinstance(found, float):
        both_nan = math.isnan(recorded) and math.isnan(found)
        return both_nan or math.isclose(recorded, found, rel_tol=tolerance)
    return bool(recorded == found)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= SHOWN_CHARACTERS else f"{text[:SHOWN_CHARACTERS]}…"
