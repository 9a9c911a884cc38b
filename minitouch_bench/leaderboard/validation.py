"""A submission checked without trusting it: nothing of it is executed."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import RUN_FILE
from minitouch_bench.leaderboard.checkpoints import check_checkpoints
from minitouch_bench.leaderboard.derived import check_actions, check_estimates, check_tables
from minitouch_bench.leaderboard.faults import Fault, Faults
from minitouch_bench.leaderboard.inventory import (
    MAX_SUBMISSION_FILE,
    RUN_LIMITS,
    check_files,
    list_files,
    read_plain,
)
from minitouch_bench.leaderboard.run_checks import PACK_AGAIN, check_run
from minitouch_bench.leaderboard.run_reader import read_run_text
from minitouch_bench.leaderboard.submission import SUBMISSION_FILE, Submission
from minitouch_bench.leaderboard.submission_reader import read_submission
from minitouch_bench.policies.loading import BUILT_IN
from minitouch_bench.records import SavedRun

RESERVED_MODALITIES: Mapping[str, tuple[str, ...]] = {
    "random": (),
    "zero": (),
    "open-loop": (),
    "scripted": ("state",),
}
"""What the calibration policies look at."""


class Depth(Enum):
    """How much is computed anew: a board leaves out what ``validate`` has proved before."""

    FULL = "full"
    BOARD = "board"


@dataclass(frozen=True)
class Verdict:
    """What a check found; ``runs`` by the place of their directory in the submission."""

    directory: Path
    submission: Submission | None
    runs: Mapping[str, SavedRun]
    faults: tuple[Fault, ...]

    @property
    def passed(self) -> bool:
        """Whether there is no fault."""
        return not self.faults

    @property
    def is_other_protocol(self) -> bool:
        """Whether nothing is wrong but that it was made under another protocol."""
        return bool(self.faults) and all(fault.is_protocol for fault in self.faults)


def validate(directory: Path, depth: Depth = Depth.FULL) -> Verdict:
    """Check a submission's directory and collect every fault.

    ``Depth.FULL`` recomputes all that follows from the episodes. ``Depth.BOARD`` leaves out
    the bootstrap intervals of ``run.json`` and the unpacking of actions and checkpoints: a
    board computes its own intervals and shows none of those.
    """
    faults = Faults()
    if not directory.is_dir():
        faults.add(str(directory), "there is no such directory", "give a submission's directory")
        return Verdict(directory, None, {}, tuple(faults))
    found = list_files(directory, faults)
    submission = _read_submission(directory, found, faults)
    runs: dict[str, SavedRun] = {}
    if submission is not None:
        check_files(submission, found, faults)
        for seed in submission.seeds:
            for suite, place in seed.runs.items():
                saved = _read_run(directory, place, found, faults)
                if saved is not None:
                    runs[place] = saved
                    before = len(faults)
                    check_run(saved, suite, seed, place, faults)
                    if len(faults) == before:  # its episodes hold by themselves
                        _check_derived(directory, place, saved, depth, faults)
            if depth is Depth.FULL:
                check_checkpoints(directory, seed, found, faults)
        _check_about(submission, runs, directory, faults)
        _check_copies(submission, runs, faults)
    return Verdict(directory, submission, runs, tuple(faults))


def _read_submission(
    directory: Path, found: Mapping[str, int], faults: Faults
) -> Submission | None:
    if SUBMISSION_FILE not in found:
        faults.add(
            SUBMISSION_FILE,
            "it is missing: this is no submission",
            "make one with minitouch-bench submit",
        )
        return None
    try:
        content = read_plain(directory, SUBMISSION_FILE, MAX_SUBMISSION_FILE)
    except RunDirectoryError as error:
        faults.add(SUBMISSION_FILE, str(error))
        return None
    return read_submission(content, faults)


def _read_run(
    directory: Path, place: str, found: Mapping[str, int], faults: Faults
) -> SavedRun | None:
    path = f"{place}/{RUN_FILE}"
    if path not in found:
        return None
    try:
        return read_run_text(read_plain(directory, path, RUN_LIMITS[RUN_FILE]), place)
    except RunDirectoryError as error:
        faults.add(path, str(error), PACK_AGAIN)
        return None


def _check_derived(
    directory: Path, place: str, saved: SavedRun, depth: Depth, faults: Faults
) -> None:
    """Check what follows from a run's episodes."""
    check_tables(directory, place, saved, faults)
    if depth is Depth.FULL:
        check_estimates(saved, place, faults)
        check_actions(directory, place, saved, faults)


def _check_about(
    submission: Submission, runs: Mapping[str, SavedRun], directory: Path, faults: Faults
) -> None:
    """Hold what the submission tells against its directory and its policies."""
    about = submission.about
    if about.name and about.name != directory.resolve().name:
        faults.add(
            SUBMISSION_FILE,
            f"the name is '{about.name}', the directory '{directory.resolve().name}'",
            "name the directory after the submission",
        )
    kinds = {run.header.policy.kind for run in runs.values()}
    for kind in sorted(kinds & set(BUILT_IN)):
        if about.name != kind:
            faults.add(SUBMISSION_FILE, f"the built-in policy {kind} is not '{about.name}'")
        if about.modalities != RESERVED_MODALITIES[kind] or len(submission.seeds) > 1:
            faults.add(
                SUBMISSION_FILE,
                f"{kind} is one seed with the modalities {list(RESERVED_MODALITIES[kind])}",
            )
    if kinds and not kinds & set(BUILT_IN):
        if about.name in BUILT_IN:
            faults.add(
                SUBMISSION_FILE, f"the name '{about.name}' is a built-in policy's", "choose another"
            )
        if not about.modalities or "state" in about.modalities:
            faults.add(
                SUBMISSION_FILE,
                "a policy sees vision, touch or both; only scripted reads the state",
                "set modalities",
            )


def _check_copies(submission: Submission, runs: Mapping[str, SavedRun], faults: Faults) -> None:
    """Refuse a training seed whose run is, bit for bit, that of another one."""
    first: dict[str, str] = {}
    for seed in submission.seeds:
        for place in seed.runs.values():
            digest = runs[place].digest if place in runs else ""
            if digest in first:
                faults.add(place, f"it is bit for bit the run {first[digest]}", "remove it")
            elif digest:
                first[digest] = place
