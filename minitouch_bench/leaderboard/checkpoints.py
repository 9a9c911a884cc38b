"""The checkpoint files of a submission: their digests, and what they declare, unopened."""

import hashlib
from pathlib import Path, PurePosixPath

from minitouch_bench.leaderboard.inventory import MAX_CHECKPOINT, read_plain
from minitouch_bench.leaderboard.submission import ALL_TASKS, CheckpointFile, TrainingSeed
from minitouch_bench.policies.declared_sizes import check_zip
from minitouch_bench.policies.loading import KIND_BY_SUFFIX
from minitouch_bench.verification.problems import Problems

ZIPPED = (".pt", ".ts", ".zip")
"""Formats that are zip archives; the others say in plain sight how large they are."""


def check_checkpoints(
    directory: Path, seed: TrainingSeed, found: dict[str, int], problems: Problems
) -> None:
    """Check the names of a training seed's files, and the bytes of those that are there."""
    for file in seed.checkpoints:
        _check_name(file, problems)
        if not file.path or file.path not in found:
            continue
        with problems.caught(file.path):
            content = read_plain(directory, file.path, MAX_CHECKPOINT)
            if hashlib.sha256(content).hexdigest() != file.sha256:
                problems.add(
                    file.path,
                    "its SHA-256 is not that of submission.toml",
                    "put the file that was evaluated there",
                )
            if PurePosixPath(file.path).suffix in ZIPPED:
                check_zip(content, PurePosixPath(file.path).name)


def _check_name(file: CheckpointFile, problems: Problems) -> None:
    name = PurePosixPath(file.file)
    if file.file and name.suffix not in KIND_BY_SUFFIX:
        problems.add(
            file.file,
            "it is no checkpoint",
            f"a checkpoint ends in {', '.join(KIND_BY_SUFFIX)}",
        )
    if file.task not in (ALL_TASKS, name.stem):
        problems.add(file.file, f"it is not named after its task {file.task}", "rename it")
