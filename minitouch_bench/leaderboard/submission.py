"""What a submission says of itself: the types of ``submission.toml``."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

from msgspec import Meta

from minitouch_bench.leaderboard.submission_rules import (
    FILE_NAME,
    LICENSE,
    LINK,
    MAX_AUTHOR,
    MAX_AUTHORS,
    MAX_LINK,
    MAX_METHOD,
    MAX_NOTES,
    MAX_SEED,
    MAX_SEEDS,
    MAX_STEPS,
    NAME,
    TEXT_PATTERN,
)
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL, TASK_NAMES
from minitouch_bench.records import Role, Sha256
from minitouch_bench.reporting.labels import TASKS

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
    license: Annotated[
        str,
        _looks_like("SPDX expression of the checkpoints' license.", f"({LICENSE.pattern})?", 63),
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
