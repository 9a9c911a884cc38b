"""What a submission says of itself: ``submission.toml`` as frozen records."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from types import MappingProxyType

from minitouch_bench.records import Role

FORMAT = "minitouch-submission"
VERSION = 1
SUBMISSION_FILE = "submission.toml"
CHECKPOINTS = "checkpoints"

ALL_TASKS = "all"
"""The task of a checkpoint that serves every task."""

MAIN_SUITE = "table4"
SUBMITTED_SUITES = (MAIN_SUITE, "novel-shapes")
"""The suites a submission may hold; the first one is required."""

MODALITIES: Mapping[str, str] = MappingProxyType(
    {
        "vision": "uses the camera image",
        "touch": "uses the touch vector",
        "state": "reads the simulator's state",
    }
)
"""What a policy may look at, and what that means."""


@dataclass(frozen=True)
class CheckpointFile:
    """One file of a policy. ``path`` is its place in the submission, "" if it is not there."""

    role: Role
    task: str
    file: str
    sha256: str
    path: str = ""


@dataclass(frozen=True)
class TrainingSeed:
    """One training run of the method: its seed, its run directory by suite, its files."""

    seed: int
    runs: Mapping[str, str]
    checkpoints: tuple[CheckpointFile, ...] = ()

    def files(self, role: Role) -> tuple[CheckpointFile, ...]:
        """Return the files of one role."""
        return tuple(file for file in self.checkpoints if file.role is role)


@dataclass(frozen=True)
class About:
    """What a submission tells a reader.

    ``training_steps`` are control steps in all environments over the whole training, 0 where
    nothing is trained. ``paper`` and ``code`` are https links, "" where there are none.
    """

    name: str
    method: str
    authors: tuple[str, ...] = ()
    paper: str = ""
    code: str = ""
    licence: str = ""
    training_steps: int = 0
    modalities: tuple[str, ...] = ()
    notes: str = ""


@dataclass(frozen=True)
class Submission:
    """A submission: what it tells, and one entry a training seed."""

    about: About
    seeds: tuple[TrainingSeed, ...]


def run_place(seed: int, suite: str) -> str:
    """Return where a submission keeps the run of a training seed on a suite."""
    return f"seed-{seed}/{suite}"


def checkpoint_place(seed: int, role: Role, file: str) -> str:
    """Return where a submission keeps a checkpoint's file."""
    return str(PurePosixPath(CHECKPOINTS, f"seed-{seed}", role.value, file))
