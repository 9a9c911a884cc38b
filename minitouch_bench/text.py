"""Text of strangers made safe to print, and words for numbers and exceptions."""

import os.path
import re
import unicodedata

UNSEEN_CHARACTERS = frozenset(
    "\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0"
    + "".join(map(chr, (*range(0x180B, 0x1810), *range(0xFE00, 0xFE10), *range(0xE0100, 0xE01F0))))
)
"""What shows nothing though Unicode calls it a letter or a mark; the rest is control or format."""


def exact(number: float) -> str:
    """Write a number so that it reads back as the same bits, a whole one without a point."""
    return repr(number).removesuffix(".0")


def printable(text: str) -> str:
    """Return the text on one line, without control, direction, surrogate and unseen characters."""
    if text.isascii() and text.isprintable():
        return text.strip()
    spaced = (" " if character.isspace() else character for character in text)
    return "".join(filter(_is_seen, spaced)).strip()


def _is_seen(character: str) -> bool:
    is_control = unicodedata.category(character).startswith("C")
    return character not in UNSEEN_CHARACTERS and not is_control


def numbered(count: int, noun: str) -> str:
    """Return a number with its noun, as "1 episode" or "2 episodes"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


MAX_TEXT = 200
"""Characters kept of any text that comes from a policy."""

ANSI_SEQUENCE = re.compile(r"\x1b(\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(\x07|\x1b\\)?|.)")


def plain_line(text: str, longest: int = MAX_TEXT) -> str:
    """Return a policy's text as one printable line of at most ``longest`` characters."""
    line = " ".join(printable(ANSI_SEQUENCE.sub("", text[: 16 * longest])).split())
    return line if len(line) <= longest else line[: longest - 1] + "…"


NO_OWN_FILE = re.compile(
    "<|.*/(site|dist)-packages/|"
    + "|".join(re.escape(f"{os.path.dirname(file)}/") for file in (os.__file__, __file__))
)
"""How the file of code begins that no policy brings: none, an installed one, Python's or ours."""


def describe(error: BaseException) -> str:
    """Return an exception as ``Type: message (file:line in function)``, in one plain line.

    The place is the innermost line of a policy's own code, if it was raised in such code.
    """
    try:
        message = str(error)
    except KeyboardInterrupt:
        raise
    except BaseException:  # an exception of the policy's own can fail here too
        message = ""
    name, place = type(error).__name__, own_place(error)
    return plain_line(f"{name}: {message}" if message else name, MAX_TEXT - len(place)) + place


def own_place(error: BaseException) -> str:
    """Return `` (file:line in function)``, the file without its folder, or "".

    Read as Python keeps it, past what an exception's class or a subclass of str defines.
    """
    place, step = "", BaseException.__dict__["__traceback__"].__get__(error)
    while step is not None:
        code = step.tb_frame.f_code
        file, function = map(str.__str__, (code.co_filename, code.co_name))
        if not NO_OWN_FILE.match(file):
            line = f"{os.path.basename(file)}:{step.tb_lineno} in {function}"
            place = f" ({plain_line(line, MAX_TEXT // 2)})"
        step = step.tb_next
    return place
