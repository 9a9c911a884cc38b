"""What was recorded beside what was found, as a list of differences."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from minitouch_bench.verification.problems import Problem

NEARLY_ZERO = 1e-12
"""Two smaller estimates are equal: a difference of means leaves such a rest."""

SHOWN_CHARACTERS = 60

ROUNDING = 1e-9
"""Relative difference of an estimate that another processor's arithmetic explains."""


def compare_values(
    place: str, recorded: Any, found: Any, tolerance: float = 0.0
) -> Iterator[Problem]:
    """Walk through two JSON values and yield each place where they differ.

    Floating-point numbers may differ by ``tolerance``, relative; 0 compares bit for bit.
    """
    if isinstance(recorded, Mapping) and isinstance(found, Mapping):
        for key in dict.fromkeys([*recorded, *found]):
            inner = f"{place}.{key}" if place else str(key)
            if key not in recorded or key not in found:
                yield Problem(inner, "missing" if key in found else "should not be there")
            else:
                yield from compare_values(inner, recorded[key], found[key], tolerance)
    elif _is_list(recorded) and _is_list(found):
        if len(recorded) != len(found):
            yield Problem(place, f"{len(recorded)} entries recorded, {len(found)} found")
        else:
            for index, pair in enumerate(zip(recorded, found, strict=True)):
                yield from compare_values(f"{place}[{index}]", *pair, tolerance)
    elif not _equal(recorded, found, tolerance):
        yield Problem(place, f"{_shown(recorded)} recorded, {_shown(found)} found")


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _equal(recorded: Any, found: Any, tolerance: float) -> bool:
    """Compare two plain values; 1 and 1.0 are the same JSON number, 1 and true are not."""
    if isinstance(recorded, bool) or isinstance(found, bool):
        return recorded is found
    if isinstance(recorded, float) and isinstance(found, float) and math.isnan(found):
        return math.isnan(recorded)
    if tolerance and isinstance(recorded, float) and isinstance(found, float):
        return math.isclose(recorded, found, rel_tol=tolerance, abs_tol=NEARLY_ZERO)
    return bool(recorded == found)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= SHOWN_CHARACTERS else f"{text[:SHOWN_CHARACTERS]}…"
