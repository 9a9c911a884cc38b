"""A submission: the types of ``submission.toml``, which its schema follows from, and its files.

The files are known plain ones of honest sizes, and none of them is executed.
"""

import hashlib
import os
import re
import stat
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Annotated, Final, Literal

from msgspec import Meta

from minitouch_bench import files
from minitouch_bench.episode import Role, Sha256
from minitouch_bench.errors import UnreadableFileError, UsageError, printable
from minitouch_bench.json_io import parse_toml, read_table, whole, write_toml
from minitouch_bench.policies.formats import FORMATS, KIND_BY_SUFFIX
from minitouch_bench.policies.sources import check_zip
from minitouch_bench.protocol.minitouch import GOAL_TASKS, MAIN_SUITE, PROTOCOL, TASK_NAMES
from minitouch_bench.reporting.labels import TASKS
from minitouch_bench.verification.static_check import Problems

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
        "proprioception": "uses the touch vector without its forces",
        "state": "reads the simulator's state",
    }
)
"""What a policy may look at, and what that means."""


def _form(pattern: str, description: str, longest: int | None = None) -> Meta:
    return Meta(pattern=whole(pattern), max_length=longest, description=description)


NAME = _form(
    r"(?!.*\.\.)(?!.*\.html$)[a-z0-9](?:[a-z0-9._-]{0,62}[a-z0-9])?",
    "A name of 1 to 64 of a-z, 0-9, '.', '_', '-', that begins and ends with a letter or digit, "
    "without '..' or '.html'.",
)
"""Of a submission: it becomes a directory and an address on every system."""
FILE_NAME = _form(
    r"(?!.*\.\.)[A-Za-z0-9][A-Za-z0-9._-]{0,126}[A-Za-z0-9]",
    "A file name of letters, digits, '.', '_', '-', that begins and ends with a letter or digit, "
    "without '..'.",
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


REFERENCE = re.compile(r"hf://[\w-][\w.-]*/[\w-][\w.-]*@[0-9a-f]{40}(?:/[\w-][\w.-]*)+", re.ASCII)
"""A file on the Hub at a full commit, in place of one that is copied."""


@dataclass(frozen=True)
class CheckpointFile:
    """One file of a policy.

    ``path`` is where it lies in the submission, ``hf://USER/REPO@COMMIT/FILE`` where it is
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
    method: Annotated[str, PLAIN_TEXT, Meta(min_length=1, max_length=120)] = ""
    authors: Annotated[
        tuple[Annotated[str, PLAIN_TEXT, Meta(max_length=100)], ...], Meta(max_length=50)
    ] = ()
    paper: Annotated[str, LINK] = ""
    code: Annotated[str, LINK] = ""
    license: Annotated[str, LICENSE] = ""
    training_steps: Annotated[int, Meta(ge=0, le=10**12)] = 0
    modalities: Annotated[
        tuple[Annotated[str, MODALITY], ...], Meta(extra_json_schema={"uniqueItems": True})
    ] = ()
    notes: Annotated[str, PLAIN_TEXT, Meta(max_length=2000)] = ""


@dataclass(frozen=True)
class FormatMark:
    """What ``submission.toml`` begins with."""

    format: Literal["minitouch-submission"] = FORMAT
    version: Literal[1] = VERSION


@dataclass(frozen=True)
class Submission(About, FormatMark):
    """What a submission says of itself, and one entry per training seed."""

    seeds: Annotated[tuple[TrainingSeed, ...], Meta(min_length=1, max_length=20)] = ()


SEE = "see docs/reference/files.md"


def read_submission(content: bytes, problems: Problems) -> Submission:
    """Read the bytes of ``submission.toml`` and return what is sound in it.

    Raises:
        UsageError: it is not a submission at all.
    """
    document = parse_toml(content, "it")
    if document.get("format") != FORMAT:
        raise UsageError(f"its format is not '{FORMAT}'")
    if document.get("version") != VERSION:  # which is not shown: it can be of any length
        raise UsageError(f"its version is not {VERSION}")
    submission, mistakes = read_table(document, Submission)
    for mistake in mistakes:
        problems.add(files.SUBMISSION_FILE, mistake, SEE)
    for key, mistake in (*_texts(submission), *_seeds(submission)):
        if key in document and not any(known.startswith(key) for known in mistakes):
            problems.add(files.SUBMISSION_FILE, f"{key}: {mistake}", SEE)
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
                remedy = f"move it to {there.path}, or write hf://USER/REPO@COMMIT/FILE or no path"
                yield "seeds", f"{what}; {remedy}"
            elif file.is_reference and PurePosixPath(file.path).name != file.file:
                yield "seeds", f"{file.file} is not the file's name in '{file.path}'"


def in_place(seed: TrainingSeed) -> TrainingSeed:
    """Return a training seed with the only paths there are, whatever it says: none leads out."""
    folder = f"seed-{seed.seed}"
    checkpoints = (
        file
        if file.is_reference or not file.path
        else replace(file, path=f"{files.CHECKPOINTS}/{folder}/{file.role}/{file.file}")
        for file in seed.checkpoints
    )
    runs = {suite: f"{folder}/{suite}" for suite in seed.runs}
    return replace(seed, runs=runs, checkpoints=tuple(checkpoints))


RUN_LIMITS = {files.RUN_FILE: 4 * files.MIB, files.ACTIONS_FILE: 12 * files.MIB}
"""The files that each run in a submission has, beside videos, and the most bytes of each."""

VIEWS = (".csv", ".md", ".html")
"""Endings of files that are written for people: of a run's facts, and not among them."""

MAX_SUBMISSION_FILE = 64 * files.KIB
MP4_MARK = b"ftyp"
"""What an MP4 file has at its fifth byte."""
MAX_VIDEO = 20 * files.MIB
MAX_FILES = 2000
MAX_DEPTH = 4

VIDEO = re.compile(rf"(?:exploration-)?(?:{'|'.join(TASK_NAMES)})-\d{{1,4}}\.mp4")


def list_files(directory: Path, problems: Problems) -> dict[str, int]:
    """Return the size in bytes of every plain file by its path; nothing is followed or opened."""
    sizes: dict[str, int] = {}
    with problems.caught(""), files.os_errors_as(UnreadableFileError, directory, "read"):
        if not directory.is_dir():
            problems.add("", "it is not a directory", "give a submission's directory")
        elif not files.is_folder(directory):
            problems.add("", "it is a link, not a directory", "give the directory itself")
        for entry in () if problems else _walk(directory):
            path = entry.path[len(str(directory)) + 1 :]
            status = entry.stat(follow_symlinks=False)
            if stat.S_ISLNK(status.st_mode):
                problems.add(path, "it is a symbolic link", "put the file itself there")
            elif stat.S_ISREG(status.st_mode):
                sizes[path] = status.st_size
            elif not stat.S_ISDIR(status.st_mode):
                problems.add(path, "it is no plain file", "remove it")
            elif path.count("/") >= MAX_DEPTH - 1:
                what = f"it is a directory more than {MAX_DEPTH} levels deep"
                problems.add(path, what, "remove it")
            if len(sizes) > MAX_FILES:
                problems.add("", f"it has more than {MAX_FILES} files", "remove some")
                break
    return sizes


def _walk(directory: Path | str, depth: int = 0) -> Iterator[os.DirEntry[str]]:
    """Walk through all that lies in a directory, in order, down to MAX_DEPTH; follow no link."""
    with os.scandir(directory) as entries:
        for entry in sorted(entries, key=lambda entry: entry.name):
            yield entry
            if entry.is_dir(follow_symlinks=False) and depth < MAX_DEPTH - 1:
                yield from _walk(entry.path, depth + 1)


def read_plain(directory: Path, path: str, limit: int) -> bytes:
    """Return the bytes of a submission's file, with an error that does not repeat its name.

    Raises:
        UnreadableFileError: it cannot be read, or is larger than ``limit``.
    """
    try:
        return files.read_file(directory / path, limit)
    except OSError as error:
        raise UnreadableFileError(f"it cannot be read: {error.strerror}") from error


def check_files(
    directory: Path, submission: Submission, sizes: Mapping[str, int], problems: Problems
) -> dict[str, str]:
    """Compare the files with those that a submission has, and return its videos' SHA-256 by path.

    A leaderboard publishes the videos, so each must be what its name says.
    """
    folders = [folder for seed in submission.seeds for folder in seed.runs.values()]
    limits = {files.SUBMISSION_FILE: MAX_SUBMISSION_FILE}
    limits |= {f"{folder}/{name}": most for folder in folders for name, most in RUN_LIMITS.items()}
    listed = (file for seed in submission.seeds for file in seed.checkpoints)
    checkpoints = {file.path for file in listed if file.path and not file.is_reference}
    limits |= dict.fromkeys(checkpoints, files.LARGEST_CHECKPOINT)
    known = {problem.place for problem in problems}
    for path in [path for path in limits if path not in sizes]:
        remedy = 'add it, or set its path to ""' if path in checkpoints else "pack the run again"
        if known.isdisjoint((path, *map(str, PurePosixPath(path).parents))):  # no link above it
            problems.add(path, "it is missing", remedy)
    digests: dict[str, str] = {}
    for path, size in sizes.items():
        folder, _, name = path.partition(f"/{files.VIDEOS}/")
        is_video = folder in folders and VIDEO.fullmatch(name)
        limit = MAX_VIDEO if is_video else limits.get(path)
        if limit is None:
            more = "; make tables and pages with minitouch-bench report"
            remedy = f"remove it{more if path.endswith(VIEWS) else ''}"
            problems.add(path, "a submission has no such file", remedy)
        elif size > limit:
            problems.add(path, f"it has {size} bytes; the limit is {limit}", "make it smaller")
        elif is_video:
            with problems.caught(path):
                content = read_plain(directory, path, MAX_VIDEO)
                digests[path] = hashlib.sha256(content).hexdigest()
                if content[4:8] != MP4_MARK:
                    problems.add(path, "it is not an MP4 video", "record it again")
    return digests


def check_checkpoints(
    directory: Path, seed: TrainingSeed, sizes: Mapping[str, int], problems: Problems
) -> None:
    """Check the names of a training seed's files, and the bytes of those that are there."""
    for file in seed.checkpoints:
        name = PurePosixPath(file.file)
        kind = KIND_BY_SUFFIX.get(name.suffix)
        if file.file and kind is None:
            remedy = f"a checkpoint ends in {', '.join(KIND_BY_SUFFIX)}"
            problems.add(file.file, "it is not a checkpoint", remedy)
        if file.task not in (ALL_TASKS, name.stem):
            problems.add(file.file, f"it is not named after its task {file.task}", "rename it")
        if file.path not in sizes:
            continue
        with problems.caught(file.path):
            content = read_plain(directory, file.path, files.LARGEST_CHECKPOINT)
            check_content(file, content, problems)


def check_content(file: CheckpointFile, content: bytes, problems: Problems) -> None:
    """Compare a checkpoint's bytes with what the submission says of it.

    Raises:
        PolicyLoadError: it is a zip that unpacks to far more than it holds.
    """
    if hashlib.sha256(content).hexdigest() != file.sha256:
        what = "its SHA-256 is not that of submission.toml"
        problems.add(file.path, what, "name or put there the file that was evaluated")
    kind = KIND_BY_SUFFIX.get(PurePosixPath(file.file).suffix)
    if kind is not None and FORMATS[kind].runs_code:
        check_zip(content, file.file)
