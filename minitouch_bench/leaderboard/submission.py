"""What a submission says of itself: the types of ``submission.toml`` and its reader.

A problem never stops the reading; the rules for names and texts are those of
``submission_rules``.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

from msgspec import Meta

from minitouch_bench.documents import parse_toml, read_table, write_toml
from minitouch_bench.errors import UsageError
from minitouch_bench.files import CHECKPOINTS, SUBMISSION_FILE
from minitouch_bench.leaderboard import submission_rules as rules
from minitouch_bench.leaderboard.facts import Fact, Place, amount
from minitouch_bench.protocol.minitouch import GOAL_TASKS, MAIN_SUITE, PROTOCOL, TASK_NAMES
from minitouch_bench.records import Role, Sha256
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


def _looks_like(description: str, pattern: str, longest: int) -> Meta:
    """Describe a text in the schema; ``submission_rules`` checks it, in words that help."""
    schema: dict[str, Any] = {"maxLength": longest, "pattern": f"^{pattern}$"}
    return Meta(description=description, extra_json_schema=schema)


def _plain_text(description: str, longest: int) -> Meta:
    return _looks_like(description, rules.TEXT_PATTERN, longest)


def _link(description: str) -> Meta:
    return _looks_like(description, f"(https://{rules.LINK.pattern})?", rules.MAX_LINK)


@dataclass(frozen=True)
class CheckpointFile:
    """One file of a policy. ``path`` is where it lies in the submission, "" if it is not there."""

    role: Role
    task: Annotated[str, Meta(pattern=f"^({'|'.join((ALL_TASKS, *TASK_NAMES))})$")]
    file: Annotated[str, _looks_like("Name of the file.", rules.FILE_NAME.pattern, 128)]
    sha256: Sha256
    path: str = ""


@dataclass(frozen=True)
class TrainingSeed:
    """One training run of the method: its seed, its run directory by suite, its files."""

    seed: Annotated[int, Meta(ge=0, le=rules.MAX_SEED)]
    runs: Mapping[str, str]
    checkpoints: tuple[CheckpointFile, ...] = ()

    def files(self, role: Role) -> tuple[CheckpointFile, ...]:
        """Return the files of one role."""
        return tuple(file for file in self.checkpoints if file.role is role)


@dataclass(frozen=True)
class About:
    """What a submission says of itself, and its row repeats.

    ``training_steps`` are control steps in all environments over the whole training, 0 where
    nothing is trained. Texts and links are "" where there are none.
    """

    name: Annotated[str, _looks_like("Its name and its directory's.", rules.NAME.pattern, 64)] = ""
    method: Annotated[
        str,
        _plain_text("What the board calls it.", rules.MAX_METHOD),
        Meta(extra_json_schema={"minLength": 1}),
        Fact("Method", Place.NAME),
    ] = ""
    authors: Annotated[
        tuple[Annotated[str, _plain_text("One of the authors.", rules.MAX_AUTHOR)], ...],
        Meta(max_length=rules.MAX_AUTHORS),
        Fact("Authors"),
    ] = ()
    paper: Annotated[str, _link("The paper."), Fact("Paper", is_link=True)] = ""
    code: Annotated[str, _link("The code."), Fact("Code", is_link=True)] = ""
    license: Annotated[
        str,
        _looks_like(
            "SPDX expression of the checkpoints' license.",
            f"({rules.LICENSE.pattern})?",
            63,
        ),
        Fact("License"),
    ] = ""
    training_steps: Annotated[
        int,
        Meta(ge=0, le=rules.MAX_STEPS),
        Fact("Training", Place.COLUMN, "control steps", amount, is_text=False),
    ] = 0
    modalities: Annotated[
        tuple[Annotated[str, Meta(pattern=f"^({'|'.join(MODALITIES)})$")], ...],
        Meta(description="What the policy uses. 'state' is the scripted policy's alone."),
        Fact("Modalities", Place.NAME),
    ] = ()
    notes: Annotated[
        str, _plain_text("Anything else, on one line.", rules.MAX_NOTES), Fact("Notes")
    ] = ""


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
        Meta(max_length=rules.MAX_SEEDS, extra_json_schema={"minItems": 1}),
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


def read_submission(content: bytes, problems: Problems) -> Submission | None:
    """Read the file's bytes; None where it is no submission at all, else what is sound in it."""
    if max(line.count(b".") for line in content.split(b"\n")) > MAX_DOTS:
        problems.add(SUBMISSION_FILE, f"a line has more than {MAX_DOTS} dots", SEE)
        return None
    try:
        document = parse_toml(content, "it")
    except UsageError as error:
        problems.add(SUBMISSION_FILE, str(error), SEE)
        return None
    if document.get("format") != FORMAT:
        problems.add(SUBMISSION_FILE, f"its format is not '{FORMAT}'", SEE)
        return None
    if document.get("version") != VERSION:  # which is not shown: it can be of any length
        problems.add(SUBMISSION_FILE, f"its version is not {VERSION}", SEE)
        return None
    submission, mistakes = read_table(document, Submission)
    for mistake in mistakes:
        problems.add(SUBMISSION_FILE, mistake, SEE)
    for key, mistake in (*_texts(submission), *_seeds(submission)):
        if key in document and not any(known.startswith(key) for known in mistakes):
            problems.add(SUBMISSION_FILE, f"{key}: {mistake}", SEE)
    return replace(submission, seeds=tuple(map(_in_place, submission.seeds)))


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
    if not submission.method:
        yield "method", "it is empty"
    for key, check in rules.TEXT_RULES.items():
        given = getattr(submission, key)
        for text in given if isinstance(given, tuple) else (given,):
            try:
                check(text)
            except UsageError as error:
                yield key, str(error)
    if len(set(submission.modalities)) < len(submission.modalities):
        yield "modalities", "one of them is there twice"


def _seeds(submission: Submission) -> Iterator[tuple[str, str]]:
    if not submission.seeds:
        yield "seeds", "there is no training seed; add a [[seeds]] table"
    numbers = [seed.seed for seed in submission.seeds]
    for number in sorted({number for number in numbers if numbers.count(number) > 1}):
        yield "seeds", f"training seed {number} is there twice; remove one"
    for seed in submission.seeds:
        for mistake in (*_runs(seed), *(m for file in seed.checkpoints for m in _file(seed, file))):
            yield "seeds", f"seed {seed.seed}, {mistake}"


def _runs(seed: TrainingSeed) -> Iterator[str]:
    """Hold the runs' paths against the only ones there are: none can lead outside."""
    if MAIN_SUITE not in seed.runs:
        yield f"it has no run of {MAIN_SUITE}; evaluate on {MAIN_SUITE}"
    for suite, path in seed.runs.items():
        if suite not in SUBMITTED_SUITES:
            yield f"'{suite}' is no suite of a submission; remove it"
        elif path != run_place(seed.seed, suite):
            yield (
                f"the run of {suite} is at '{path}', outside its place; "
                f"move it to {run_place(seed.seed, suite)}"
            )


def _in_place(seed: TrainingSeed) -> TrainingSeed:
    """Return a training seed with the only paths there are, whatever it says."""
    folders = {suite: run_place(seed.seed, suite) for suite in SUBMITTED_SUITES}
    files = (
        replace(file, path=file.path and checkpoint_place(seed.seed, file.role, file.file))
        for file in seed.checkpoints
        if not list(_file(seed, replace(file, path="")))
    )
    runs = {suite: folder for suite, folder in folders.items() if suite in seed.runs}
    return replace(seed, runs=runs, checkpoints=tuple(files))


def _file(seed: TrainingSeed, file: CheckpointFile) -> Iterator[str]:
    try:
        rules.check_file_name(file.file)
    except UsageError as error:
        yield f"file: {error}"
        return
    expected = checkpoint_place(seed.seed, file.role, file.file)
    if file.path not in ("", expected):
        what = f"{file.file} is at '{file.path}', outside its place"
        yield f"{what}; move it to {expected}, or write no path"
