"""Pack finished runs and the checkpoints of their policies as a submission, or remove one."""

import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench import files
from minitouch_bench.episode import PolicyIdentity, Role
from minitouch_bench.errors import PolicyLoadError, RunDirectoryError, UsageError, printable
from minitouch_bench.json_io import write_toml
from minitouch_bench.leaderboard.proof import PROOFS
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    MAX_VIDEO,
    NAME,
    RUN_LIMITS,
    SUBMITTED_SUITES,
    CheckpointFile,
    Submission,
    TrainingSeed,
    in_place,
)
from minitouch_bench.leaderboard.validation import validate
from minitouch_bench.policies.policy import DIRECTORY, PolicySource
from minitouch_bench.policies.sources import HUB, parse_hub_address, parse_source
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.runs.run import Run
from minitouch_bench.verification.static_check import Problem

PACKING = ".packing"
"""Folder beside the submissions where one is made; the next call removes a killed call's."""


@dataclass(frozen=True)
class PackedTraining:
    """One training of a method: its finished runs by suite, and its checkpoint files.

    ``files`` maps each entry of ``submission.toml`` to the file that is copied, None where it is
    referenced, or only its SHA-256 is kept.
    """

    runs: Mapping[str, Run]
    files: Mapping[CheckpointFile, Path | None]

    def entry(self, seed: int) -> TrainingSeed:
        """Return what ``submission.toml`` says of this training, whose number is ``seed``."""
        return in_place(TrainingSeed(seed, dict.fromkeys(self.runs, ""), tuple(self.files)))


def group_by_training(runs: Sequence[Run], *, include: bool) -> list[PackedTraining]:
    """Return the trainings in the order of their first runs: runs of one policy are one training.

    Args:
        runs: Official runs, one per policy and suite, each policy with one of MAIN_SUITE.
        include: Reference the checkpoints on the Hub, and copy the others that are still where
            they were evaluated.

    Raises:
        UsageError: a run is not official, missing or there twice, or the policy of a run is a
            directory that has changed.
    """
    by_policy: dict[tuple[str, str], dict[str, Run]] = {}
    for run in runs:
        policy, suite = run.header.policy, run.plan.suite
        if suite not in SUBMITTED_SUITES or not run.header.official:
            reasons = "; ".join(run.header.unofficial_because) or f"suite {suite}"
            raise UsageError(f"{run.directory} is not an official run: {reasons}")
        of_policy = by_policy.setdefault((policy.kind, policy.digest or policy.source), {})
        if suite in of_policy:
            both = f"{of_policy[suite].directory} and {run.directory}"
            raise UsageError(f"{both} are runs of {suite} with one policy: give one of them")
        of_policy[suite] = run
    trainings = []
    for of_policy in by_policy.values():
        if MAIN_SUITE not in of_policy:
            alone = next(iter(of_policy.values())).directory
            raise UsageError(f"no run is of {MAIN_SUITE} with the policy of {alone}: add it")
        header = of_policy[MAIN_SUITE].header
        policies = {Role.FINAL: header.policy, Role.EXPLORATION: header.exploration}
        named = dict(
            file
            for role, recorded in policies.items()
            if recorded is not None
            for file in _checkpoint_files(role, _find_source(recorded))
        )
        files_there = named if include else {replace(file, path=""): None for file in named}
        listed = {suite: of_policy[suite] for suite in SUBMITTED_SUITES if suite in of_policy}
        trainings.append(PackedTraining(listed, files_there))
    return trainings


def _find_source(recorded: PolicyIdentity) -> PolicySource:
    """Find the policy of a finished run again, or what is known of it where it is gone."""
    try:
        source = parse_source(recorded.source, contact=False)
        if (source.kind, source.digest) == (recorded.kind, recorded.digest):
            return source
    except PolicyLoadError:
        pass
    if recorded.kind == DIRECTORY:  # which is known by its files alone
        raise UsageError(
            f"the policy {recorded.source} has changed or is not there: put it back, or submit in "
            "the directory where it was evaluated"
        )
    return PolicySource(recorded.kind, recorded.name, recorded.source, recorded.digest)


def _checkpoint_files(
    role: Role, policy: PolicySource
) -> Iterator[tuple[CheckpointFile, Path | None]]:
    """Walk through the files of a policy, each with where it is, None on the Hub or where gone."""
    parts = policy.parts if policy.kind == DIRECTORY else ((ALL_TASKS, policy),)
    for task, part in parts:
        if part.digest:
            address = part.address or part.target
            if address.startswith(HUB):
                hub = parse_hub_address(address)
                reference = f"{HUB}{hub.repository}@{hub.revision}/{hub.file}"
                file = CheckpointFile(role, task, Path(hub.file).name, part.digest, reference)
                yield file if file.is_reference else replace(file, path=""), None
            else:
                path = Path(address) if os.path.isfile(address) else None
                there = str(path or "")
                yield CheckpointFile(role, task, Path(address).name, part.digest, there), path


def pack(
    submission: Submission, trainings: Sequence[PackedTraining], submissions: Path
) -> tuple[Problem, ...]:
    """Make a submission in a folder aside, check it, and move it to its name in one rename.

    Args:
        submission: Its seeds are the entries of ``trainings``, in their order.
        trainings: What is copied.
        submissions: Directory of all submissions.

    Returns:
        The problems for which it would be refused; where there is one, nothing is written.

    Raises:
        RunDirectoryError: one of this name is there, or a file cannot be read or written.
    """
    target = submissions / submission.name
    with lock_aside(submissions) as folder:
        if os.path.lexists(target):
            raise RunDirectoryError(
                f"{target} is there: minitouch-bench leaderboard remove {target.name}, or choose "
                "another --name"
            )
        copy = folder / submission.name
        files.write_file(copy / files.SUBMISSION_FILE, write_toml(submission))
        for seed, training in zip(submission.seeds, trainings, strict=True):
            for suite, run in training.runs.items():
                assert run.directory is not None
                copy_run(run.directory, copy / seed.runs[suite])
            for file, source in zip(seed.checkpoints, training.files.values(), strict=True):
                if source is not None:
                    _copy(source, copy / file.path, files.LARGEST_CHECKPOINT, follow=True)
        problems = validate(copy).problems
        if not problems:
            with files.os_errors_as(RunDirectoryError, target, "written"):
                copy.rename(target)
        return problems


@contextmanager
def lock_aside(submissions: Path) -> Iterator[Path]:
    """Hold an empty folder beside the submissions, which no board reads; remove it afterwards."""
    folder = submissions / PACKING
    with files.lock_directory(submissions, wait=True):
        with files.os_errors_as(RunDirectoryError, folder, "cleared"):
            if os.path.lexists(folder):
                shutil.rmtree(folder)
            folder.mkdir()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def copy_run(run: Path, target: Path) -> None:
    """Copy the facts of a finished run, and its videos.

    Raises:
        RunDirectoryError: a file cannot be read or written.
    """
    for name, limit in RUN_LIMITS.items():
        _copy(run / name, target / name, limit)
    for video in files.list_videos(run):
        _copy(video, target / files.VIDEOS / video.name, MAX_VIDEO)


def _copy(file: Path, target: Path, limit: int, *, follow: bool = False) -> None:
    """Copy a plain file; the user's own may be a link, one of a run may not."""
    with files.os_errors_as(RunDirectoryError, file, "copied"):
        files.write_file(target, files.read_file(file, limit, follow=follow))


def find_removable(submissions: Path, name: str) -> dict[Path, str]:
    """Return the folder and the proof of a submission that are there, each with what it is.

    Raises:
        UsageError: neither is there.
    """
    there: dict[Path, str] = {}
    folder = submissions / name
    if re.search(str(NAME.pattern), name):  # so that it leads nowhere else
        if folder.is_dir():
            sizes = [path.lstat().st_size for path in folder.rglob("*") if not path.is_dir()]
            there[folder] = f"{len(sizes)} files, {sum(sizes) / files.MIB:.1f} MiB"
        if os.path.lexists(proof := submissions / PROOFS / f"{name}.json"):
            there[proof] = "its proof"
    if not there:
        raise UsageError(f"there is no submission '{printable(name)}' in {submissions}")
    return there


def remove_submission(submissions: Path, there: Iterable[Path]) -> None:
    """Remove what ``find_removable`` found; killed in between, it leaves nothing half removed.

    Raises:
        RunDirectoryError: a file cannot be removed.
    """
    with lock_aside(submissions) as aside:
        for path in there:
            with files.os_errors_as(RunDirectoryError, path, "removed"):
                path.rename(aside / path.name)
