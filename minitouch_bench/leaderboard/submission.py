"""What a submission says of itself: the types of ``submission.toml``, and what it may say."""

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal
from urllib.parse import urlsplit

from msgspec import Meta

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL, TASK_NAMES
from minitouch_bench.records import Role, Sha256
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.frames import FORMULA_STARTS
from minitouch_bench.reporting.labels import TASKS

NAME = re.compile(r"[a-z0-9](?:[a-z0-9._-]{0,62}[a-z0-9])?")
"""A submission's name: it becomes a directory and an address on every system."""

DEVICE = re.compile(r"con|prn|aux|nul|(com|lpt)[0-9]", re.IGNORECASE)
"""What no file can be called on Windows, whatever its ending."""
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,126}[A-Za-z0-9]")
LICENCE = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+ ()-]{0,62}")
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
    if not NAME.fullmatch(text) or ".." in text:
        raise UsageError(
            f"{_shown(text)} is no name: 1 to 64 of a-z, 0-9, '.', '_', '-', "
            "with a letter or digit at both ends"
        )
    _check_windows(text)


def _check_windows(text: str) -> None:
    if DEVICE.fullmatch(text.partition(".")[0]):
        raise UsageError(f"{_shown(text)} is the name of a device on Windows; choose another")


def check_file_name(text: str) -> None:
    """Refuse a file name that holds more than letters, digits, '.', '_' and '-'.

    Raises:
        UsageError: it does.
    """
    if not FILE_NAME.fullmatch(text) or ".." in text:
        raise UsageError(f"{_shown(text)} is no plain file name of letters, digits, '.', '_', '-'")
    _check_windows(text)


def check_text(text: str, longest: int) -> None:
    """Refuse text that is too long or that a page, table or terminal could take for more.

    Raises:
        UsageError: saying why.
    """
    if len(text) > longest:
        raise UsageError(f"it has {len(text)} characters; the limit is {longest}")
    if printable(text) != text or "  " in text:
        raise UsageError(
            f"{_shown(text)} has control characters, line breaks or spare spaces; "
            "write it on one line"
        )
    if unicodedata.normalize("NFC", text) != text:
        raise UsageError(f"{_shown(text)} is not in Unicode's composed form (NFC)")
    if "<" in text or ">" in text:
        raise UsageError(f"{_shown(text)} holds < or >, as HTML does")
    if text.startswith(FORMULA_STARTS):
        raise UsageError(f"{_shown(text)} begins like a spreadsheet's formula")


def check_licence(text: str) -> None:
    """Refuse a licence that is no SPDX expression such as "Apache-2.0".

    Raises:
        UsageError: it is something else.
    """
    if text and not LICENCE.fullmatch(text):
        raise UsageError(f"{_shown(text)} is no SPDX licence such as Apache-2.0 or MIT")


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


def _shown(text: str) -> str:
    plain = printable(text)
    return f"'{plain if len(plain) <= SHOWN else plain[:SHOWN] + '…'}'"


FORMAT: Final = "minitouch-submission"
VERSION: Final = 1
SUBMISSION_FILE = "submission.toml"
CHECKPOINTS = "checkpoints"

ALL_TASKS = "all"
"""The task of a checkpoint that serves every task."""

MAIN_SUITE = "table4"
BOARD_TASKS = tuple(task for task in TASKS if task in PROTOCOL.suite(MAIN_SUITE).tasks)
"""The tasks that the board shows and ranks: those of its main suite."""
BOARD_GOALS = tuple(task for task in BOARD_TASKS if task in GOAL_TASKS)
SUBMITTED_SUITES = tuple(suite.name for suite in PROTOCOL.suites if suite.rankable)
"""The suites a submission may hold; MAIN_SUITE is required."""

MODALITIES: Mapping[str, str] = MappingProxyType(
    {
        "vision": "uses the camera image",
        "touch": "uses the touch vector",
        "state": "reads the simulator's state",
    }
)
"""What a policy may look at, and what that means."""


def _looks_like(description: str, pattern: str, longest: int) -> Meta:
    """Describe a text in the schema; ``texts`` checks it, in words that help."""
    schema: dict[str, Any] = {"maxLength": longest, "pattern": f"^{pattern}$"}
    return Meta(description=description, extra_json_schema=schema)


def _plain_text(description: str, longest: int) -> Meta:
    return _looks_like(description, TEXT_PATTERN, longest)


def _link(description: str) -> Meta:
    return _looks_like(description, f"(https://{LINK.pattern})?", MAX_LINK)


@dataclass(frozen=True)
class CheckpointFile:
    """One file of a policy. ``path`` is where it lies in the submission, "" if it is not there."""

    role: Role
    task: Annotated[str, Meta(pattern=f"^({'|'.join((ALL_TASKS, *TASK_NAMES))})$")]
    file: Annotated[str, _looks_like("Name of the file.", FILE_NAME.pattern, 128)]
    sha256: Sha256
    path: str = ""


@dataclass(frozen=True)
class TrainingSeed:
    """One training run of the method: its seed, its run directory by suite, its files."""

    seed: Annotated[int, Meta(ge=0, le=MAX_SEED)]
    runs: Mapping[str, str]
    checkpoints: tuple[CheckpointFile, ...] = ()

    def files(self, role: Role) -> tuple[CheckpointFile, ...]:
        """Return the files of one role."""
        return tuple(file for file in self.checkpoints if file.role is role)


@dataclass(frozen=True)
class Submission:
    """What a submission tells a reader, and one entry per training seed.

    ``training_steps`` are control steps in all environments over the whole training, 0 where
    nothing is trained. Texts and links are "" where there are none.
    """

    format: Literal["minitouch-submission"] = FORMAT
    version: Literal[1] = VERSION
    name: Annotated[str, _looks_like("Its name and its directory's.", NAME.pattern, 64)] = ""
    method: Annotated[
        str,
        _plain_text("What the board calls it.", MAX_METHOD),
        Meta(extra_json_schema={"minLength": 1}),
    ] = ""
    authors: Annotated[
        tuple[Annotated[str, _plain_text("One of the authors.", MAX_AUTHOR)], ...],
        Meta(max_length=MAX_AUTHORS),
    ] = ()
    paper: Annotated[str, _link("The paper.")] = ""
    code: Annotated[str, _link("The code.")] = ""
    licence: Annotated[
        str,
        _looks_like("SPDX expression of the checkpoints' licence.", f"({LICENCE.pattern})?", 63),
    ] = ""
    training_steps: Annotated[int, Meta(ge=0, le=MAX_STEPS)] = 0
    modalities: Annotated[
        tuple[Annotated[str, Meta(pattern=f"^({'|'.join(MODALITIES)})$")], ...],
        Meta(description="What the policy uses. 'state' is the scripted policy's alone."),
    ] = ()
    notes: Annotated[str, _plain_text("Anything else, on one line.", MAX_NOTES)] = ""
    seeds: Annotated[
        tuple[TrainingSeed, ...],
        Meta(max_length=MAX_SEEDS, extra_json_schema={"minItems": 1}),
    ] = ()


def run_place(seed: int, suite: str) -> str:
    """Return where a submission keeps the run of a training seed on a suite."""
    return f"seed-{seed}/{suite}"


def checkpoint_place(seed: int, role: Role, file: str) -> str:
    """Return where a submission keeps a checkpoint's file."""
    return str(PurePosixPath(CHECKPOINTS, f"seed-{seed}", role.value, file))
