"""A submission: the types of ``submission.toml``, which its schema follows from, and its rules.

It has a policy for each training, and words about them. None of it is executed here.
"""

import hashlib
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Annotated, Literal

from msgspec import Meta

from minitouch_bench import files
from minitouch_bench.episode import Role
from minitouch_bench.errors import MiniTouchError, PolicyLoadError, RunDirectoryError, UsageError
from minitouch_bench.json_io import read_toml, take_table, whole
from minitouch_bench.policies.formats import BUILT_IN, FORMATS, KIND_BY_SUFFIX
from minitouch_bench.policies.sources import (
    ALL_TASKS,
    CheckpointFile,
    SubmittedTraining,
    check_zip,
)
from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL
from minitouch_bench.text import printable

SUITES = tuple(suite.name for suite in PROTOCOL.suites if suite.rankable)
"""The suites that a submission can be for."""

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
"""The name of a submission is also that of a directory and an address on every system."""
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
Text = Annotated[str, PLAIN_TEXT, Meta(max_length=120)]


@dataclass(frozen=True, kw_only=True)
class About:
    """What a submission says of itself, and its row repeats.

    ``training_steps`` are control steps in all environments over a whole training, 0 where nothing
    is trained. ``learner``: what learned, as far as rows with the same one can be compared, such as
    "SAC on keypoints, preset default". The modality "state" is the scripted policy's alone.
    ``suites``: those that it is meant for. Texts and links are "" where there are none.
    """

    name: Annotated[str, NAME]
    method: Annotated[Text, Meta(min_length=1)]
    learner: Text = ""
    training_steps: Annotated[int, Meta(ge=0, le=10**12)]
    suites: Annotated[
        tuple[Literal[SUITES], ...],  # type: ignore[valid-type]  # the protocol's own names
        Meta(min_length=1, extra_json_schema={"uniqueItems": True}),
    ] = (MAIN_SUITE,)
    modalities: Annotated[
        tuple[Literal[tuple(MODALITIES)], ...],  # type: ignore[valid-type]
        Meta(extra_json_schema={"uniqueItems": True}),
    ] = ()
    authors: Annotated[tuple[Text, ...], Meta(max_length=50)] = ()
    paper: Annotated[str, LINK] = ""
    code: Annotated[str, LINK] = ""
    license: Annotated[str, LICENSE] = ""
    notes: Annotated[str, PLAIN_TEXT, Meta(max_length=2000)] = ""


@dataclass(frozen=True, kw_only=True)
class FormatMark:
    """The first keys of ``submission.toml``."""

    format: Literal["minitouch-submission"] = "minitouch-submission"
    version: Literal[2] = 2


@dataclass(frozen=True, kw_only=True)
class Submission(About, FormatMark):
    """What a submission says of itself, and the checkpoints of each of its trainings."""

    trainings: Annotated[tuple[SubmittedTraining, ...], Meta(min_length=1, max_length=20)]

    @property
    def is_built_in(self) -> bool:
        """Whether it is one of the built-in policies, which have no checkpoints."""
        return self.name in BUILT_IN

    @property
    def explores(self) -> bool:
        """Whether it has exploration policies."""
        return any(training.files(Role.EXPLORATION) for training in self.trainings)


def read_submission(directory: Path) -> Submission:
    """Read the ``submission.toml`` of a directory.

    Raises:
        UsageError: it is missing, too large or not a submission.
    """
    path = directory / files.SUBMISSION_FILE
    table = read_toml(path, follow=False)
    mark = FormatMark()
    if (table.get("format"), table.get("version")) != (mark.format, mark.version):
        raise UsageError(f"{path} is not a {mark.format} of version {mark.version}")
    return take_table(table, Submission, str(path))


def check_submission(directory: Path) -> Iterator[str]:
    """Yield every problem of a submission's directory: its words, its files and their bytes."""
    try:
        submission = read_submission(directory)
    except UsageError as error:
        yield str(error)
        return
    if directory.is_symlink():
        yield "it is a link: a submission is a directory of its own"
    if submission.name != directory.name:
        yield f"the name is '{submission.name}', the directory '{directory.name}'"
    if found := [*mistakes(submission)]:
        yield from found
        return
    yield from _check_files(directory, submission)


def mistakes(submission: Submission) -> Iterator[str]:
    """Yield the contradictions of a submission whose values are valid one by one."""
    for text in (submission.method, submission.learner, submission.notes, *submission.authors):
        if printable(text) != text or not unicodedata.is_normalized("NFC", text):
            yield f"'{printable(text)}' has unseen characters or is not in composed form (NFC)"
    if submission.method.rstrip().lower().endswith("(paper)"):
        yield "a method that ends in '(paper)' is the paper's own row: choose another name"
    if submission.training_steps and not submission.learner:
        yield "learner is missing, as in --learner 'PPO, CNN'"
    seeds = [training.seed for training in submission.trainings]
    named = {"modalities": submission.modalities, "suites": submission.suites, "seeds": seeds}
    for what, words in named.items():
        if len({*words}) < len(words):
            yield f"{what}: one of them is there twice; remove one"
    if submission.is_built_in:
        sees = ("state",) if submission.name == "scripted" else ()
        if submission.modalities != sees or len(seeds) > 1 or submission.trainings[0].checkpoints:
            yield f"{submission.name} is one training without checkpoints, modalities {list(sees)}"
        return
    if not submission.modalities or "state" in submission.modalities:
        yield "modalities: a policy sees vision, touch or both; only scripted reads the state"
    without = [str(one.seed) for one in submission.trainings if not one.files(Role.EXPLORATION)]
    if 0 < len(without) < len(seeds):
        yield f"no exploration policy: training seeds {', '.join(without)}; give all or none"
    digests = [training.digest(Role.FINAL) for training in submission.trainings]
    if len({*digests}) < len(digests):
        yield "two trainings have the same final checkpoints: they are one training"
    for training in submission.trainings:
        yield from _training_mistakes(training)


def _training_mistakes(training: SubmittedTraining) -> Iterator[str]:
    seed = f"training seed {training.seed}"
    final, explored = (training.files(role) for role in Role)
    if not final:
        yield f"{seed} has no final checkpoint"
    for listed in (final, explored):
        names, tasks = {file.file for file in listed}, {file.task for file in listed}
        if min(len(names), len(tasks)) < len(listed) or (ALL_TASKS in tasks and len(listed) > 1):
            yield f"{seed}: give one file for all tasks, or one file of its own for each task"
    if {file.sha256 for file in final} & {file.sha256 for file in explored}:
        yield f"{seed}: an exploration policy is the final policy, which learned the task's reward"
    for file in training.checkpoints:
        name = PurePosixPath(file.file)
        if name.suffix not in KIND_BY_SUFFIX:
            yield f"{file.file} is not a checkpoint; known are {', '.join(KIND_BY_SUFFIX)}"
        if file.task not in (ALL_TASKS, name.stem):
            yield f"{file.file} is not named after its task {file.task}: rename it"
        if file.address and PurePosixPath(file.address).name != file.file:
            yield f"{file.file} is not the name of the file in '{file.address}'"


def _check_files(directory: Path, submission: Submission) -> Iterator[str]:
    """Compare the files of a directory with those that the submission lists, byte for byte."""
    listed = {
        training.place(file): file
        for training in submission.trainings
        for file in training.checkpoints
        if not file.address
    }
    missing = {*listed}
    for path in sorted(directory.rglob("*")):  # which follows no link
        place = path.relative_to(directory).as_posix()
        missing.discard(place)
        if place == files.SUBMISSION_FILE or files.is_folder(path):
            continue
        if place not in listed:
            yield f"{place}: a submission has no such file; remove it"
            continue
        try:
            with files.os_errors_as(RunDirectoryError, path, "read"):
                content = files.read_file(path, files.LARGEST_CHECKPOINT)
            _check_content(listed[place], content)
        except MiniTouchError as error:
            yield str(error)
    for place in sorted(missing):
        yield f"{place} is missing"


def _check_content(file: CheckpointFile, content: bytes) -> None:
    if hashlib.sha256(content).hexdigest() != file.sha256:
        raise PolicyLoadError(f"{file.file}: its SHA-256 is not that of {files.SUBMISSION_FILE}")
    if FORMATS[KIND_BY_SUFFIX[PurePosixPath(file.file).suffix]].runs_code:
        check_zip(content, file.file)


def find_submissions(directory: Path) -> list[Path]:
    """Return the directories of submissions, without those whose name begins with "_" or ".".

    Raises:
        UsageError: the directory does not exist, or cannot be read.
    """
    with files.os_errors_as(UsageError, directory, "read"):
        if directory.is_dir():
            return sorted(
                path
                for path in directory.iterdir()
                if not path.name.startswith(("_", ".")) and (path.is_dir() or path.is_symlink())
            )
    raise UsageError(f"{directory} is not a directory of submissions; name one with --submissions")
