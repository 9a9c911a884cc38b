"""Checked access to a JSON document: every mistake becomes one clear line."""

import math
from collections.abc import Iterator
from typing import Any

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.rendering.escaping import printable


class JsonNode:
    """A JSON value and its place in the document.

    Every method raises RunDirectoryError where the value is missing or of another type.
    """

    __slots__ = ("_inside", "_name", "_value")

    def __init__(self, value: Any, name: str | int, inside: "JsonNode | None" = None) -> None:
        self._value = value
        self._name = name
        self._inside = inside

    @property
    def _place(self) -> str:
        """Where the value stands; put together only where it is told."""
        if self._inside is None:
            return str(self._name)
        if isinstance(self._name, int):
            return f"{self._inside._place}[{self._name}]"
        return f"{self._inside._place}.{self._name}"

    def __getitem__(self, key: str) -> "JsonNode":
        """Return a member of an object."""
        if not isinstance(self._value, dict):
            raise self._mistake("an object")
        if key not in self._value:
            raise RunDirectoryError(f"{self._place}: '{key}' is missing")
        return JsonNode(self._value[key], key, self)

    def __iter__(self) -> Iterator["JsonNode"]:
        """Walk through a list."""
        if not isinstance(self._value, list):
            raise self._mistake("a list")
        for position, value in enumerate(self._value):
            yield JsonNode(value, position, self)

    def mapping(self) -> dict[str, "JsonNode"]:
        """Return an object's members by name."""
        if not isinstance(self._value, dict):
            raise self._mistake("an object")
        return {key: JsonNode(value, key, self) for key, value in self._value.items()}

    @property
    def is_null(self) -> bool:
        """Whether the value is null."""
        return self._value is None

    def text(self) -> str:
        """Return a string."""
        if not isinstance(self._value, str):
            raise self._mistake("text")
        return self._value

    def flag(self) -> bool:
        """Return a truth value."""
        if not isinstance(self._value, bool):
            raise self._mistake("true or false")
        return self._value

    def integer(self) -> int:
        """Return a whole number."""
        if not isinstance(self._value, int) or isinstance(self._value, bool):
            raise self._mistake("a whole number")
        return self._value

    def count(self) -> int:
        """Return a whole number that is not negative."""
        value = self.integer()
        if value < 0:
            raise self._mistake("0 or more")
        return value

    def number(self) -> float:
        """Return a finite number."""
        if not isinstance(self._value, int | float) or isinstance(self._value, bool):
            raise self._mistake("a number")
        if not math.isfinite(self._value):
            raise self._mistake("a finite number")
        return float(self._value)

    def texts(self) -> tuple[str, ...]:
        """Return a list of strings."""
        return tuple(node.text() for node in self)

    def text_mapping(self) -> dict[str, str]:
        """Return an object whose members are strings."""
        return {key: node.text() for key, node in self.mapping().items()}

    def choice(self, allowed: tuple[str, ...]) -> str:
        """Return a string that is one of those allowed."""
        if self.text() not in allowed:
            raise self._mistake(f"one of {', '.join(allowed)}")
        return self.text()

    def _mistake(self, wanted: str) -> RunDirectoryError:
        """Say in one line what stands where something else should."""
        found = printable(repr(self._value))
        shown = found if len(found) <= 40 else f"{found[:40]}…"
        return RunDirectoryError(f"{self._place} should be {wanted}, not {shown}")
