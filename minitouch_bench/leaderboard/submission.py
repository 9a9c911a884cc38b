"""What a submission says of itself: the types of ``submission.toml``, and its reader.

The types say what each value may be, and the published schema follows from them. A field with a
``ColumnSpec`` is also shown: the board's CSV and Markdown files, the site's tables and the
submission's page go over these fields, so a new one needs no other code.
"""

import re
import unicodedata
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, get_type_hints

from msgspec import Meta

from minitouch_bench.episode import Role, Sha256
from minitouch_bench.errors import UsageError, printable
from minitouch_bench.files import CHECKPOINTS, SUBMISSION_FILE
from minitouch_bench.json_io import parse_toml, read_table, whole, write_toml
from minitouch_bench.protocol.minitouch import GOAL_TASKS, MAIN_SUITE, PROTOCOL, TASK_NAMES
from minitouch_bench.reporting.labels import TASKS
from minitouch_bench.verification.problems import Problems

FORMAT: Final = "minitouch-submission"
VERSION: Final = 1

ALL_TASKS = "all"
"""The task of a checkpoint that serves every task."""

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


def _form(pattern: str, description: str, longest: int | None = None) -> Meta:
    return Meta(pattern=whole(pattern), max_length=longest, description=description)


DEVICES = re.sub(
    "[a-z]",
    lambda letter: f"[{letter[0]}{letter[0].upper()}]",
    "(?:con|prn|aux|nul|com[0-9]|lpt[0-9])",
)
"""What no file can be called on Windows, whatever its ending."""
PLAIN_FILE = rf"(?!{DEVICES}(?:\.|$))(?!.*\.\.)"

NAME = _form(
    rf"{PLAIN_FILE}(?!.*\.html$)[a-z0-9](?:[a-z0-9._-]{{0,62}}[a-z0-9])?",
    "A name of 1 to 64 of a-z, 0-9, '.', '_', '-', that begins and ends with a letter or digit, "
    "without '..' or '.html', and is not a device of Windows.",
)
"""Of a submission: it becomes a directory and an address on every system."""
FILE_NAME = _form(
    rf"{PLAIN_FILE}[A-Za-z0-9][A-Za-z0-9._-]{{0,126}}[A-Za-z0-9]",
    "A file name of letters, digits, '.', '_', '-', that begins and ends with a letter or digit, "
    "without '..', and is not a device of Windows.",
)
PLAIN_TEXT = _form(
    r"(?![=+@ -])(?!.*(?:  | $))[^<>\x00-\x1f\x7f]*",
    "Plain text on one line, without <, > and spare spaces, that does not begin as a "
    "spreadsheet's formula.",
)
LINK = _form(
    r"(?:https://[A-Za-z0-9-]+(?:\.[A-Za-z0-9-]+)+(?::[0-9]+)?"
    r"(?:[/?#][A-Za-z0-9._~:/?#\[\]@!$&'()*+,;=%-]*)?)?",
    "A link https://HOST/... without a user name, or nothing.",
    longest=300,
)
LICENSE = _form(
    "(?:[A-Za-z0-9][A-Za-z0-9.+ ()-]{0,62})?",
    "An SPDX expression such as Apache-2.0 or MIT, or nothing.",
)
MODALITY = _form("|".join(MODALITIES), f"One of {', '.join(MODALITIES)}.")
SUITE = _form("|".join(SUBMITTED_SUITES), f"One of {', '.join(SUBMITTED_SUITES)}.")
TASK = _form("|".join((ALL_TASKS, *TASK_NAMES)), f"A task, or '{ALL_TASKS}'.")


def in_words(value: object) -> str:
    """Write a value for people; "" where there is none."""
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value or "")


def amount(number: int) -> str:
    """Write a large number short: 2 M, 1.5 k; one that is not exact with three digits."""
    rounded = float(f"{number:.3g}")
    for size, unit in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rounded >= size:
            return f"{rounded / size:.3g}\u202f{unit}"
    return str(number) if number else "none"


@dataclass(frozen=True)
class ColumnSpec:
    """How a field of a row is shown, given in the field's ``Annotated`` type.

    Args:
        label: Heading of the column.
        place: Where the field is shown beside the list on the submission's page, which has all
            of them. "column": in the CSV and Markdown files, and in a column of the site's
            overall table. "name": in these files, and below the row's name in that table.
            "page": nowhere else.
        unit: What a number counts.
        write: Gives the text for people, "" where there is nothing to say. The CSV file has the
            value itself: the words of a tuple with spaces between, or how many numbers it has.
        is_text: Whether the column has words.
        is_link: Whether the value is an address.
    """

    label: str
    place: Literal["column", "name", "page"] = "page"
    unit: str = ""
    write: Callable[[Any], str] = in_words
    is_text: bool = True
    is_link: bool = False


def columns_of(kind: type) -> Mapping[str, ColumnSpec]:
    """Return the columns of a record by the names of their fields, in order."""
    return {
        name: note
        for name, hint in get_type_hints(kind, include_extras=True).items()
        for note in getattr(hint, "__metadata__", ())
        if isinstance(note, ColumnSpec)
    }


REFERENCE = re.compile(r"hf://[\w-][\w.-]*/[\w-][\w.-]*@[0-9a-f]{40}(?:/[\w-][\w.-]*)+", re.ASCII)
"""A file on the Hub at a full commit, in place of one that is copied."""


@dataclass(frozen=True)
class CheckpointFile:
    """One file of a policy.

    ``path`` is where it lies in the submission, ``hf://OWNER/REPO@COMMIT/FILE`` where it is
    fetched from the Hub, "" if it is not there.
    """

    role: Role
    task: Annotated[str, TASK]
    file: Annotated[str, FILE_NAME]
    sha256: Sha256
    path: str = ""

    @property
    def is_reference(self) -> bool:
        """Whether the file is on the Hub, at a full commit."""
        return REFERENCE.fullmatch(self.path) is not None


@dataclass(frozen=True)
class TrainingSeed:
    """One training run of the method: its seed, its run directory by suite, its files."""

    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    runs: Annotated[
        Mapping[Annotated[str, SUITE], str], Meta(extra_json_schema={"required": [MAIN_SUITE]})
    ]
    checkpoints: tuple[CheckpointFile, ...] = ()

    def files(self, role: Role) -> tuple[CheckpointFile, ...]:
        """Return the files of one role."""
        return tuple(file for file in self.checkpoints if file.role is role)


@dataclass(frozen=True)
class About:
    """What a submission says of itself, and its row repeats.

    ``training_steps`` are control steps in all environments over the whole training, 0 where
    nothing is trained. The modality "state" is the scripted policy's alone. Texts and links are
    "" where there are none.
    """

    name: Annotated[str, NAME] = ""
    method: Annotated[
        str, PLAIN_TEXT, Meta(min_length=1, max_length=120), ColumnSpec("Method", "name")
    ] = ""
    authors: Annotated[
        tuple[Annotated[str, PLAIN_TEXT, Meta(max_length=100)], ...],
        Meta(max_length=50),
        ColumnSpec("Authors"),
    ] = ()
    paper: Annotated[str, LINK, ColumnSpec("Paper", is_link=True)] = ""
    code: Annotated[str, LINK, ColumnSpec("Code", is_link=True)] = ""
    license: Annotated[str, LICENSE, ColumnSpec("License")] = ""
    training_steps: Annotated[
        int,
        Meta(ge=0, le=10**12),
        ColumnSpec("Training", "column", "control steps", amount, is_text=False),
    ] = 0
    modalities: Annotated[
        tuple[Annotated[str, MODALITY], ...],
        Meta(extra_json_schema={"uniqueItems": True}),
        ColumnSpec("Modalities", "name"),
    ] = ()
    notes: Annotated[str, PLAIN_TEXT, Meta(max_length=2000), ColumnSpec("Notes")] = ""


@dataclass(frozen=True)
class FormatMark:
    """What ``submission.toml`` begins with."""

    format: Literal["minitouch-submission"] = FORMAT
    version: Literal[1] = VERSION


@dataclass(frozen=True)
class Submission(About, FormatMark):
    """What a submission says of itself, and one entry per training seed."""

    seeds: Annotated[
        tuple[TrainingSeed, ...],
        Meta(min_length=1, max_length=20),
    ] = ()


def run_place(seed: int, suite: str) -> str:
    """Return where a submission keeps the run of a training seed on a suite."""
    return f"seed-{seed}/{suite}"


def checkpoint_place(seed: int, role: Role, file: str) -> str:
    """Return where a submission keeps a checkpoint's file."""
    return str(PurePosixPath(CHECKPOINTS, f"seed-{seed}", role.value, file))


SEE = "see docs/reference/files.md"

MAX_DOTS = 4000
"""In a line. Of a key of 32,000 parts tomllib takes 4 GB; the longest text is half as long."""


def read_submission(content: bytes, problems: Problems) -> Submission:
    """Read the bytes of ``submission.toml`` and return what is sound in it.

    Raises:
        UsageError: it is not a submission at all.
    """
    if max(line.count(b".") for line in content.split(b"\n")) > MAX_DOTS:
        raise UsageError(f"a line has more than {MAX_DOTS} dots")
    document = parse_toml(content, "it")
    if document.get("format") != FORMAT:
        raise UsageError(f"its format is not '{FORMAT}'")
    if document.get("version") != VERSION:  # which is not shown: it can be of any length
        raise UsageError(f"its version is not {VERSION}")
    submission, mistakes = read_table(document, Submission)
    for mistake in mistakes:
        problems.add(SUBMISSION_FILE, mistake, SEE)
    for key, mistake in (*_texts(submission), *_seeds(submission)):
        if key in document and not any(known.startswith(key) for known in mistakes):
            problems.add(SUBMISSION_FILE, f"{key}: {mistake}", SEE)
    return replace(submission, seeds=tuple(map(in_place, submission.seeds)))


def check_submission(submission: Submission) -> None:
    """Refuse what a submission cannot say of itself.

    Raises:
        UsageError: the first problem.
    """
    problems = Problems()
    read_submission(write_toml(submission).encode(), problems)
    for problem in problems:
        raise UsageError(str(problem))


def _texts(submission: Submission) -> Iterator[tuple[str, str]]:
    """Walk through what no pattern can say of texts."""
    for key in ("method", "authors", "notes"):
        given = getattr(submission, key)
        for text in given if isinstance(given, tuple) else (given,):
            if printable(text) != text:
                yield key, f"'{printable(text)}' has control or unseen characters; remove them"
            elif not unicodedata.is_normalized("NFC", text):
                yield key, f"'{text}' is not in Unicode's composed form (NFC)"
    if len(set(submission.modalities)) < len(submission.modalities):
        yield "modalities", "one of them is there twice"


def _seeds(submission: Submission) -> Iterator[tuple[str, str]]:
    numbers = [seed.seed for seed in submission.seeds]
    for number in sorted({number for number in numbers if numbers.count(number) > 1}):
        yield "seeds", f"training seed {number} is there twice; remove one"
    for seed in submission.seeds:
        if MAIN_SUITE not in seed.runs:
            yield "seeds", f"seed {seed.seed} has no run of {MAIN_SUITE}; add one"
        places = in_place(seed)
        for suite, path in seed.runs.items():
            if path != places.runs[suite]:
                what = f"the run of {suite} is at '{path}', outside its place"
                yield "seeds", f"{what}; move it to {places.runs[suite]}"
        for file, there in zip(seed.checkpoints, places.checkpoints, strict=True):
            if file.path != there.path:
                what = f"{file.file} is at '{file.path}', outside its place"
                remedy = f"move it to {there.path}, or write hf://OWNER/REPO@COMMIT/FILE or no path"
                yield "seeds", f"{what}; {remedy}"
            elif file.is_reference and PurePosixPath(file.path).name != file.file:
                yield "seeds", f"{file.file} is not the file's name in '{file.path}'"


def in_place(seed: TrainingSeed) -> TrainingSeed:
    """Return a training seed with the only paths there are, whatever it says: none leads out."""
    files = (
        file
        if file.is_reference or not file.path
        else replace(file, path=checkpoint_place(seed.seed, file.role, file.file))
        for file in seed.checkpoints
    )
    runs = {suite: run_place(seed.seed, suite) for suite in seed.runs}
    return replace(seed, runs=runs, checkpoints=tuple(files))
