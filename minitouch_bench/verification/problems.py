"""What is wrong with a run or a submission: every problem, one line each, with what to do."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from minitouch_bench.errors import MiniTouchError
from minitouch_bench.rendering.escaping import printable

SHOWN_CHARACTERS = 400
"""Characters of one part of a problem; a stranger's text never fills the screen."""


@dataclass(frozen=True)
class Problem:
    """One problem: the file or key, what is wrong there, and what to do about it.

    ``is_other_protocol``: the run is of another protocol, which is no mistake of its maker.
    """

    place: str
    what: str
    remedy: str = ""
    is_other_protocol: bool = False

    def __str__(self) -> str:
        parts = [f"{_shown(self.place)}: {_shown(self.what)}"]
        return "; ".join(parts + ([_shown(self.remedy)] if self.remedy else []))


class Problems:
    """The problems found so far; a check goes on after the first one."""

    def __init__(self) -> None:
        self._found: dict[Problem, None] = {}

    def __iter__(self) -> Iterator[Problem]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def add(self, place: str, what: str, remedy: str = "") -> None:
        """Keep a problem; equal ones count once."""
        self._found[Problem(place, what, remedy)] = None

    def add_below(self, place: str, problem: Problem) -> None:
        """Keep a problem of something that lies at ``place``."""
        self._found[replace(problem, place=f"{place}, {problem.place}")] = None

    @contextmanager
    def caught(self, place: str, remedy: str = "") -> Iterator[None]:
        """Keep an error of the block as a problem and go on behind it."""
        try:
            yield
        except MiniTouchError as error:
            self.add(place, str(error).replace("\n", " "), remedy)


def _shown(text: str) -> str:
    plain = printable(text)
    return plain if len(plain) <= SHOWN_CHARACTERS else f"{plain[:SHOWN_CHARACTERS]}…"
