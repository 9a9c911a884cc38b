"""Make text from a policy or a file safe to print; each writer adds its own escapes."""

import unicodedata


def printable(text: str) -> str:
    """Return the text on one line, without control, direction and surrogate characters."""
    if text.isascii() and text.isprintable():
        return text.strip()
    return "".join(map(_character, text)).strip()


def _character(character: str) -> str:
    """Return one character as it may be printed."""
    if character.isspace():
        return " "
    return "" if unicodedata.category(character).startswith("C") else character
