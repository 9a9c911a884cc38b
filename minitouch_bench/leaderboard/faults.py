"""What is wrong with a submission: every fault, one line each, with how to mend it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from minitouch_bench.errors import MiniTouchError
from minitouch_bench.rendering.escaping import printable

SHOWN_CHARACTERS = 400
"""Characters of one part of a fault; a stranger's text never fills the screen."""


@dataclass(frozen=True)
class Fault:
    """One fault: the file or key, what is wrong there, and what to do about it.

    ``is_protocol``: the run is of another protocol, which is no mistake of its maker.
    """

    place: str
    what: str
    mend: str = ""
    is_protocol: bool = False

    def __str__(self) -> str:
        parts = [f"{_shown(self.place)}: {_shown(self.what)}"]
        return "; ".join(parts + ([_shown(self.mend)] if self.mend else []))


class Faults:
    """The faults found so far; a check goes on after the first one."""

    def __init__(self) -> None:
        self._found: dict[Fault, None] = {}

    def __iter__(self) -> Iterator[Fault]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def add(self, place: str, what: str, mend: str = "", *, is_protocol: bool = False) -> None:
        """Keep a fault; equal ones count once."""
        self._found[Fault(place, what, mend, is_protocol)] = None

    @contextmanager
    def caught(self, place: str, mend: str = "") -> Iterator[None]:
        """Keep an error of the block as a fault and go on behind it."""
        try:
            yield
        except MiniTouchError as error:
            self.add(place, str(error).replace("\n", " "), mend)


def _shown(text: str) -> str:
    plain = printable(text)
    return plain if len(plain) <= SHOWN_CHARACTERS else f"{plain[:SHOWN_CHARACTERS]}…"
