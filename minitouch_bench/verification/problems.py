"""What a check finds in a run or a submission, a line per problem; comparison of JSON values."""

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from minitouch_bench.errors import (
    PolicyError,
    RunDirectoryError,
    UnreadableFileError,
    UsageError,
    printable,
)

SHOWN_CHARACTERS = 400
"""Characters of one part of a problem; a stranger's text never fills the screen."""

NEARLY_ZERO = 1e-12
"""Two smaller estimates are equal: a difference of means leaves such a rest."""
VALUE_CHARACTERS = 60
"""Characters of a value in a difference."""
ROUNDING = 1e-9
"""Relative difference of an estimate that another processor's arithmetic explains."""


@dataclass(frozen=True)
class Problem:
    """One problem: the file or key, what is wrong there, and what to do about it.

    ``place`` is "" for the whole directory.
    ``is_other_protocol``: the run is of another protocol, which is no mistake of its maker.
    ``is_unchecked``: a file could not be read here, so that nothing is known of it.
    """

    place: str
    what: str
    remedy: str = ""
    is_other_protocol: bool = False
    is_unchecked: bool = False

    def __str__(self) -> str:
        place = f"{_shown(self.place)}: " if self.place else ""
        remedy = f"; {_shown(self.remedy)}" if self.remedy else ""
        return f"{place}{_shown(self.what)}{remedy}"


@dataclass(frozen=True)
class Findings:
    """What a check found: its problems, and how many episodes it played.

    ``replayed``: from their recorded actions; ``reran``: with the checkpoint.
    """

    problems: tuple[Problem, ...] = ()
    replayed: int = 0
    reran: int = 0

    @property
    def passed(self) -> bool:
        """Whether everything is as recorded."""
        return not self.problems


class Problems:
    """The problems found so far; a check goes on after the first one."""

    def __init__(self) -> None:
        self._found: dict[Problem, None] = {}

    def __iter__(self) -> Iterator[Problem]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def add(self, place: str, what: str, remedy: str = "", *, unchecked: bool = False) -> None:
        """Keep a problem; equal ones count once."""
        self._found[Problem(place, what, remedy, is_unchecked=unchecked)] = None

    def add_below(self, place: str, problems: Iterable[Problem], remedy: str = "") -> None:
        """Keep the problems of something that lies at ``place``, with a remedy of all."""
        for one in problems:
            moved = replace(one, place=f"{place}, {one.place}", remedy=remedy or one.remedy)
            self._found[moved] = None

    @contextmanager
    def caught(self, place: str, remedy: str = "") -> Iterator[None]:
        """Keep what the block's errors say of files and policies, and go on; other errors pass."""
        try:
            yield
        except UnreadableFileError as error:
            self.add(place, str(error), unchecked=True)
        except (UsageError, PolicyError, RunDirectoryError) as error:
            self.add(place, str(error).replace("\n", " "), remedy)


def _shown(text: str, longest: int = SHOWN_CHARACTERS) -> str:
    plain = printable(text)
    return plain if len(plain) <= longest else f"{plain[:longest]}…"


def compare_values(path: str, recorded: Any, computed: Any) -> Iterator[Problem]:
    """Yield each place where two JSON values differ; estimates may differ by ROUNDING."""
    if isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for key in dict.fromkeys([*recorded, *computed]):
            inner = f"{path}.{key}" if path else str(key)
            if key not in recorded or key not in computed:
                yield Problem(inner, "missing" if key in computed else "should not be there")
            else:
                yield from compare_values(inner, recorded[key], computed[key])
    elif isinstance(recorded, list | tuple) and isinstance(computed, list | tuple):
        if len(recorded) != len(computed):
            yield Problem(path, f"{len(recorded)} entries recorded, {len(computed)} found")
        else:
            for index, pair in enumerate(zip(recorded, computed, strict=True)):
                yield from compare_values(f"{path}[{index}]", *pair)
    elif not _equal(recorded, computed):
        then, now = (_shown(repr(value), VALUE_CHARACTERS) for value in (recorded, computed))
        yield Problem(path, f"{then} recorded, {now} found")


def _equal(recorded: Any, computed: Any) -> bool:
    if isinstance(recorded, float) and isinstance(computed, float):
        return math.isclose(recorded, computed, rel_tol=ROUNDING, abs_tol=NEARLY_ZERO)
    return bool(recorded == computed)
