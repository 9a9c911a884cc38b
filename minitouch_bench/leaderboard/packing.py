"""Make a submission's directory of finished runs and their checkpoints."""

import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.documents import write_toml
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.files import (
    ACTIONS_FILE,
    JOURNAL_FILE,
    REPORT_PAGE,
    RUN_FILE,
    SUBMISSION_FILE,
    VIDEOS,
    list_videos,
    make_folder,
    os_errors_as,
    read_file,
    write_file,
)
from minitouch_bench.leaderboard.inventory import (
    MAX_CHECKPOINT,
    MAX_SUBMISSION_FILE,
    MAX_VIDEO,
    RUN_LIMITS,
    read_plain,
)
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    CheckpointFile,
    Submission,
    TrainingSeed,
    checkpoint_place,
    read_submission,
)
from minitouch_bench.leaderboard.submission_rules import check_file_name
from minitouch_bench.policies.sources import DIRECTORY, HUB, PolicySource, parse_hub_address
from minitouch_bench.records import Role
from minitouch_bench.reporting.run_directory import derived_files, read_run
from minitouch_bench.verification.problems import Problems

LEFT_BEHIND = (JOURNAL_FILE, REPORT_PAGE)
"""What an evaluation writes and a submission does not need."""


def begun_submission(directory: Path) -> Submission | None:
    """Return the submission that the directory holds already, None if there is none.

    Raises:
        UsageError: its ``submission.toml`` has a problem.
    """
    if not (directory / SUBMISSION_FILE).exists():
        return None
    problems = Problems()
    content = read_plain(directory, SUBMISSION_FILE, MAX_SUBMISSION_FILE)
    submission = read_submission(content, problems)
    for problem in problems:
        raise UsageError(str(problem))
    return submission


def with_seed(begun: Submission | None, told: Submission, seed: TrainingSeed) -> Submission:
    """Return what is told, with this training seed added or put in place of its old entry.

    Raises:
        UsageError: the result would be refused.
    """
    others = [other for other in (begun.seeds if begun else ()) if other.seed != seed.seed]
    seeds = tuple(sorted((*others, seed), key=lambda one: one.seed))
    submission = replace(told, seeds=seeds)
    check_submission(submission)
    return submission


def add_seed(
    directory: Path, begun: Submission | None, told: Submission, seed: TrainingSeed
) -> Submission:
    """Write ``with_seed`` into a submission's directory.

    Raises:
        UsageError: the result would be refused.
        RunDirectoryError: it cannot be written.
    """
    submission = with_seed(begun, told, seed)
    write_file(directory / SUBMISSION_FILE, write_toml(submission))
    return submission


def check_submission(submission: Submission) -> None:
    """Refuse what ``validate`` would refuse, before any episode is run.

    A submission without a training seed gets one to be checked with.

    Raises:
        UsageError: the first problem.
    """
    placeholder = TrainingSeed(0, {"table4": "seed-0/table4"})
    seeds = submission.seeds or (placeholder,)
    problems = Problems()
    read_submission(write_toml(replace(submission, seeds=seeds)).encode(), problems)
    for problem in problems:
        raise UsageError(str(problem))


def tidy(directory: Path) -> None:
    """Turn the directory of a finished evaluation into that of a submission's run.

    Raises:
        RunDirectoryError: it is no run, or cannot be written.
    """
    saved = read_run(directory)
    for name, text in derived_files(saved, directory).items():
        write_file(directory / name, text)
    with os_errors_as(RunDirectoryError, directory, "written"):
        for name in LEFT_BEHIND:
            (directory / name).unlink(missing_ok=True)


def copy_run(run: Path, place: Path) -> None:
    """Copy what a submission needs of a finished run.

    Raises:
        RunDirectoryError: it is no run, or cannot be read or written.
    """
    read_run(run)
    for name in (ACTIONS_FILE, RUN_FILE):
        _copy(run / name, place / name, RUN_LIMITS[name])
    for video in list_videos(run):
        _copy(video, place / VIDEOS / video.name, MAX_VIDEO)
    tidy(place)


@dataclass(frozen=True)
class Parts:
    """What a training seed's part of a submission is made of: its runs by suite, its policies."""

    runs: Mapping[str, Path]
    policy: PolicySource
    exploration: PolicySource | None

    def digests_there(self, removed: Path | None) -> set[str]:
        """Return the SHA-256 of the checkpoint files that are where they were evaluated.

        Those in a directory that is to be ``removed`` do not count.
        """
        files = [
            file for _, one in self._sources() for file in (one, *(part for _, part in one.parts))
        ]
        paths = {Path(file.target): file.digest for file in files}
        return {
            digest
            for path, digest in paths.items()
            if path.is_file() and not (removed and path.resolve().is_relative_to(removed.resolve()))
        }

    def gone(self) -> list[str]:
        """Return the checkpoints that are no longer where they were evaluated."""
        return [one.target for _, one in self._sources() if not _is_there(one)]

    def name_files(
        self, directory: Path, seed: int, *, include: bool
    ) -> tuple[CheckpointFile, ...]:
        """Return the checkpoint files of both roles; with ``include`` those there are copied.

        Raises:
            UsageError: a file's name is not plain.
            RunDirectoryError: one cannot be copied.
        """
        return tuple(
            file
            for role, source in self._sources()
            for file in name_files(
                directory, source, role, seed, include=include and _is_there(source)
            )
        )

    def _sources(self) -> Iterator[tuple[Role, PolicySource]]:
        yield Role.FINAL, self.policy
        if self.exploration is not None:
            yield Role.EXPLORATION, self.exploration


def _is_there(source: PolicySource) -> bool:
    return not source.digest or Path(source.target).exists()


def name_files(
    directory: Path, source: PolicySource, role: Role, seed: int, *, include: bool
) -> tuple[CheckpointFile, ...]:
    """Return the checkpoint files of a policy; with ``include`` they are copied as well.

    Raises:
        UsageError: a file's name is not plain.
        RunDirectoryError: one cannot be copied.
    """
    if source.kind == DIRECTORY:
        parts = [(task, part) for task, part in source.parts]
    else:
        parts = [(ALL_TASKS, source)] if source.digest else []
    files = []
    for task, part in parts:
        target = part.target
        name = Path(parse_hub_address(target).file if target.startswith(HUB) else target).name
        check_file_name(name)
        file = CheckpointFile(role, task, name, part.digest)
        if include:
            file = replace(file, path=checkpoint_place(seed, role, name))
            _copy(Path(part.target), directory / file.path, MAX_CHECKPOINT, follow=True)
        files.append(file)
    return tuple(files)


def _copy(file: Path, place: Path, limit: int, *, follow: bool = False) -> None:
    """Copy a plain file; the user's own may be a link, one of a run may not."""
    with os_errors_as(RunDirectoryError, file, "copied"):
        write_file(place, read_file(file, limit, follow=follow))


@contextmanager
def aside(directory: Path) -> Iterator[Path]:
    """Make a folder beside the submissions, which no board reads, and remove it afterwards."""
    folder = make_folder(directory / f".{secrets.token_hex(8)}.partial")
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def swap(new: Path, place: Path, old: Path) -> None:
    """Put a directory in the place of another one, which is kept until the new one is there."""
    with os_errors_as(RunDirectoryError, place, "replaced"):
        old.parent.mkdir(parents=True, exist_ok=True)
        if place.exists():
            place.rename(old)
        if new.exists():
            place.parent.mkdir(parents=True, exist_ok=True)
            try:
                new.rename(place)
            except OSError:
                if old.exists():
                    old.rename(place)
                raise
