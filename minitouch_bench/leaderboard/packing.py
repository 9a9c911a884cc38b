"""Make a submission's directory of finished runs and their checkpoints."""

import secrets
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench import files
from minitouch_bench.documents import write_toml
from minitouch_bench.errors import (
    PolicyLoadError,
    RunDirectoryError,
    UnreadableFileError,
    UsageError,
)
from minitouch_bench.leaderboard.inventory import (
    MAX_SUBMISSION_FILE,
    MAX_VIDEO,
    RUN_LIMITS,
    read_plain,
)
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    SUBMITTED_SUITES,
    CheckpointFile,
    Submission,
    TrainingSeed,
    checkpoint_place,
    read_submission,
    run_place,
)
from minitouch_bench.leaderboard.submission_rules import check_file_name
from minitouch_bench.policies.sources import (
    DIRECTORY,
    HUB,
    PolicySource,
    parse_hub_address,
    parse_source,
)
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.records import PolicyIdentity, Role
from minitouch_bench.runs.run import RunHeader
from minitouch_bench.verification.problems import Problems


def begun_submission(directory: Path) -> Submission | None:
    """Return the submission that the directory holds already, None if there is none.

    Raises:
        UsageError: its ``submission.toml`` has a problem.
        UnreadableFileError: it cannot be read.
    """
    file = directory / files.SUBMISSION_FILE
    with files.os_errors_as(UnreadableFileError, file, "read"):
        if not file.exists():
            return None
    return _checked(read_plain(directory, files.SUBMISSION_FILE, MAX_SUBMISSION_FILE))


def with_seeds(
    begun: Submission | None, about: Submission, seeds: Sequence[TrainingSeed]
) -> Submission:
    """Return ``about`` with the seeds begun and these, added or in place of their old entries.

    Raises:
        UsageError: ``validate`` would refuse the result.
    """
    by_number = {seed.seed: seed for seed in (*(begun.seeds if begun else ()), *seeds)}
    submission = replace(about, seeds=tuple(by_number[number] for number in sorted(by_number)))
    check_submission(submission)
    return submission


def add_seeds(directory: Path, about: Submission, seeds: Sequence[TrainingSeed]) -> Submission:
    """Write ``with_seeds`` of the submission that a directory holds into it.

    Raises:
        UsageError: ``validate`` would refuse the result.
        RunDirectoryError: it cannot be written.
    """
    submission = with_seeds(begun_submission(directory), about, seeds)
    files.write_file(directory / files.SUBMISSION_FILE, write_toml(submission))
    return submission


def check_submission(submission: Submission) -> None:
    """Refuse what ``validate`` would refuse before any episode, with or without a training seed.

    Raises:
        UsageError: the first problem.
    """
    seeds = submission.seeds or (TrainingSeed(0, {MAIN_SUITE: run_place(0, MAIN_SUITE)}),)
    _checked(write_toml(replace(submission, seeds=seeds)).encode())


def _checked(content: bytes) -> Submission | None:
    problems = Problems()
    submission = read_submission(content, problems)
    for problem in problems:
        raise UsageError(str(problem))
    return submission


def copy_run(run: Path, target: Path) -> None:
    """Copy the facts of a finished run, and its videos.

    Raises:
        RunDirectoryError: a file cannot be read or written.
    """
    for name, limit in RUN_LIMITS.items():
        _copy(run / name, target / name, limit)
    for video in files.list_videos(run):
        _copy(video, target / files.VIDEOS / video.name, MAX_VIDEO)


@dataclass(frozen=True)
class Parts:
    """What a training seed's part of a submission is made of: its runs by suite, its policies."""

    runs: Mapping[str, Path]
    policy: PolicySource
    exploration: PolicySource | None

    def gone(self) -> list[str]:
        """Return the checkpoint files that are no longer where they were evaluated."""
        return [file.target for _, _, file in self._files() if not Path(file.target).exists()]

    def digests_there(self, removed: Path | None) -> set[str]:
        """Return the SHA-256 of the checkpoint files that are where they were evaluated.

        Those in a directory that is to be ``removed`` do not count.
        """
        return {
            file.digest
            for _, _, file in self._files()
            if (path := Path(file.target)).is_file()
            and not (removed and path.resolve().is_relative_to(removed.resolve()))
        }

    def name_files(
        self, directory: Path, seed: int, *, include: bool
    ) -> tuple[CheckpointFile, ...]:
        """Return the checkpoint files of both policies; with ``include`` those there are copied.

        Raises:
            UsageError: a file's name is not plain.
            RunDirectoryError: one cannot be copied.
        """
        named = []
        for role, task, source in self._files():
            target = source.target
            name = Path(parse_hub_address(target).file if target.startswith(HUB) else target).name
            check_file_name(name)
            file = CheckpointFile(role, task, name, source.digest)
            if include and Path(target).exists():
                file = replace(file, path=checkpoint_place(seed, role, name))
                _copy(Path(target), directory / file.path, files.LARGEST_CHECKPOINT, follow=True)
            named.append(file)
        return tuple(named)

    def _files(self) -> Iterator[tuple[Role, str, PolicySource]]:
        """Walk through the files of both policies, each with its role and its task."""
        for role, source in ((Role.FINAL, self.policy), (Role.EXPLORATION, self.exploration)):
            if source is not None and source.kind == DIRECTORY:
                yield from ((role, task, part) for task, part in source.parts)
            elif source is not None and source.digest:
                yield role, ALL_TASKS, source


def _copy(file: Path, target: Path, limit: int, *, follow: bool = False) -> None:
    """Copy a plain file; the user's own may be a link, one of a run may not."""
    with files.os_errors_as(RunDirectoryError, file, "copied"):
        files.write_file(target, files.read_file(file, limit, follow=follow))


def check_submittable(header: RunHeader, path: Path, main: PolicyIdentity) -> None:
    """Refuse a run that is not official, or that is of another policy than the ``main`` run.

    Raises:
        UsageError: it is one of these.
    """
    if header.plan.suite not in SUBMITTED_SUITES or not header.official:
        reasons = "; ".join(header.unofficial_because) or f"suite {header.plan.suite}"
        raise UsageError(f"{path} is not an official run: {reasons}")
    if (header.policy.kind, header.policy.digest) != (main.kind, main.digest):
        raise UsageError(f"{path} is the run of another policy than that of {MAIN_SUITE}")


def find_source(recorded: PolicyIdentity) -> PolicySource:
    """Find the policy of a finished run again, or what is known of it where it is gone.

    Raises:
        UsageError: it is a directory, which is known by its files alone.
    """
    try:
        source = parse_source(recorded.source, trust=True, contact=False)
        if (source.kind, source.digest) == (recorded.kind, recorded.digest):
            return source
    except PolicyLoadError:
        pass
    if recorded.kind == DIRECTORY:
        raise UsageError(f"the policy {recorded.source} has changed or is gone: put it back")
    return PolicySource(recorded.kind, recorded.name, recorded.source, recorded.digest)


@contextmanager
def aside(directory: Path) -> Iterator[Path]:
    """Make a folder beside the submissions, which no board reads, and remove it afterwards."""
    folder = files.make_folder(directory / f".{secrets.token_hex(8)}.packing")
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def swap(new: Path, target: Path, old: Path) -> None:
    """Put a directory in the place of another one, which is kept until the new one is there."""
    with files.os_errors_as(RunDirectoryError, target, "replaced"):
        old.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            target.rename(old)
        if new.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                new.rename(target)
            except OSError:
                if old.exists():
                    old.rename(target)
                raise
