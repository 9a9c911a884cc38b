"""Make text from a policy or a file safe to print; each writer adds its own escapes."""

import unicodedata

UNSEEN = frozenset(
    "\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0"
    + "".join(map(chr, (*range(0x180B, 0x1810), *range(0xFE00, 0xFE10), *range(0xE0100, 0xE01F0))))
)
"""What shows nothing though Unicode calls it a letter or a mark; the rest is control or format."""


def printable(text: str) -> str:
    """Return the text on one line, without control, direction, surrogate and unseen characters."""
    if text.isascii() and text.isprintable():
        return text.strip()
    return "".join(map(_character, text)).strip()


def _character(character: str) -> str:
    if character.isspace():
        return " "
    if character in UNSEEN or unicodedata.category(character).startswith("C"):
        return ""
    return character
