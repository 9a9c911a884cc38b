"""Make text from a policy or a file safe to print; each writer adds its own escapes."""

import unicodedata
from functools import lru_cache

REPEATED = 64
"""Characters up to which a text is likely to come again, as a task's or a shape's name does."""


def printable(text: str) -> str:
    """Return the text on one line, without control, direction and surrogate characters."""
    return _remembered(text) if len(text) <= REPEATED else _cleaned(text)


@lru_cache(maxsize=8192)
def _remembered(text: str) -> str:
    return _cleaned(text)


def _cleaned(text: str) -> str:
    kept = (_character(character) for character in text)
    return "".join(kept).strip()


def _character(character: str) -> str:
    """Return one character as it may be printed."""
    if character.isspace():
        return " "
    return "" if unicodedata.category(character).startswith("C") else character
