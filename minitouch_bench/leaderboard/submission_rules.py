"""What a submission may say of itself: how much, and which names, texts and links are let in."""

import re
import unicodedata
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from urllib.parse import urlsplit

from minitouch_bench.errors import UsageError
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.frames import FORMULA_STARTS

NAME = re.compile(r"[a-z0-9](?:[a-z0-9._-]{0,62}[a-z0-9])?")
"""A submission's name: it becomes a directory and an address on every system."""

DEVICE = re.compile(r"con|prn|aux|nul|(com|lpt)[0-9]", re.IGNORECASE)
"""What no file can be called on Windows, whatever its ending."""
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,126}[A-Za-z0-9]")
LICENSE = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+ ()-]{0,62}")
LINK = re.compile(r"[A-Za-z0-9._~:/?#\[\]@!$&'()*+,;=%-]+")
TEXT_PATTERN = "(?![=+@-])[^<>\\u0000-\\u001f\\u007f]*"
"""What ``check_text`` lets in, as far as a schema can say it."""

MAX_METHOD, MAX_AUTHOR, MAX_NOTES = 120, 100, 2000
MAX_AUTHORS, MAX_SEEDS = 50, 20
MAX_STEPS = 10**12
MAX_SEED = 2**63 - 1
MAX_LINK = 300
SHOWN = 40


def check_name(text: str) -> None:
    """Refuse a name that could not be a directory everywhere.

    Raises:
        UsageError: saying what a name looks like.
    """
    form = "1 to 64 of a-z, 0-9, '.', '_', '-', with a letter or digit at both ends"
    _check_file(text, NAME, f"no name: {form}")
    if text.endswith(".html"):
        raise UsageError(f"no name: '{text[:SHOWN]}' could be another submission's page")


def check_file_name(text: str) -> None:
    """Refuse a file name that holds more than letters, digits, '.', '_' and '-'.

    Raises:
        UsageError: it does.
    """
    _check_file(text, FILE_NAME, "no plain file name of letters, digits, '.', '_', '-'")


def _check_file(text: str, form: re.Pattern[str], fault: str) -> None:
    if not form.fullmatch(text) or ".." in text:
        raise UsageError(f"{_shown(text)} is {fault}")
    if DEVICE.fullmatch(text.partition(".")[0]):
        raise UsageError(f"{_shown(text)} is the name of a device on Windows; choose another")


TEXT_FAULTS: Mapping[str, Callable[[str], bool]] = MappingProxyType(
    {
        "has control characters, line breaks or spare spaces; write it on one line": (
            lambda text: printable(text) != text or "  " in text
        ),
        "is not in Unicode's composed form (NFC)": (
            lambda text: unicodedata.normalize("NFC", text) != text
        ),
        "holds < or >, as HTML does": lambda text: "<" in text or ">" in text,
        "begins like a spreadsheet's formula": lambda text: text.startswith(FORMULA_STARTS),
    }
)


def check_text(text: str, longest: int) -> None:
    """Refuse text that is too long or that a page, table or terminal could take for more.

    Raises:
        UsageError: saying why.
    """
    if len(text) > longest:
        raise UsageError(f"it has {len(text)} characters; the limit is {longest}")
    for fault, is_found in TEXT_FAULTS.items():
        if is_found(text):
            raise UsageError(f"{_shown(text)} {fault}")


def check_license(text: str) -> None:
    """Refuse a license that is not an SPDX expression. "Apache-2.0" is one.

    Raises:
        UsageError: it is something else.
    """
    if text and not LICENSE.fullmatch(text):
        raise UsageError(f"{_shown(text)} is no SPDX license such as Apache-2.0 or MIT")


def check_link(text: str) -> None:
    """Refuse a link that is not plain https to a named host; "" is none.

    Raises:
        UsageError: saying what a link looks like.
    """
    if not text:
        return
    try:
        parts = urlsplit(text)
        plain = parts.scheme == "https" and bool(parts.hostname) and "." in str(parts.hostname)
        plain = plain and parts.username is None and parts.password is None
    except ValueError:
        plain = False
    if not plain or len(text) > MAX_LINK or not LINK.fullmatch(text):
        raise UsageError(
            f"{_shown(text)} is no link: https://HOST/..., at most {MAX_LINK} ASCII characters, "
            "no user name"
        )


TEXT_RULES: Mapping[str, Callable[[str], None]] = MappingProxyType(
    {
        "name": check_name,
        "method": partial(check_text, longest=MAX_METHOD),
        "authors": partial(check_text, longest=MAX_AUTHOR),
        "paper": check_link,
        "code": check_link,
        "license": check_license,
        "notes": partial(check_text, longest=MAX_NOTES),
    }
)
"""What each text of ``submission.toml`` must pass; each of the authors by itself."""


def _shown(text: str) -> str:
    plain = printable(text)
    return f"'{plain if len(plain) <= SHOWN else plain[:SHOWN] + '…'}'"
