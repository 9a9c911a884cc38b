"""A run's directory while it is being filled: its lock, its actions, its clearing."""

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.protocol.journal import JOURNAL_FILE
from minitouch_bench.records import EpisodeRecord

LOCK_FILE = ".lock"
ACTIONS_FILE = "actions.npz"
RUN_FILES = (
    JOURNAL_FILE,
    ACTIONS_FILE,
    "run.json",
    "episodes.csv",
    "exploration.csv",
    "table4.csv",
    "generalization.csv",
    "report.md",
    "report.html",
)
"""What a run writes, and all that ``--fresh`` removes beside ``videos/``."""


@contextlib.contextmanager
def lock_directory(directory: Path) -> Iterator[None]:
    """Create the directory if need be, and hold it alone.

    Raises:
        RunDirectoryError: it cannot be written, or another run holds it.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        handle = os.open(directory / LOCK_FILE, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise RunDirectoryError(f"{directory} cannot be written: {error.strerror}") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise RunDirectoryError(
                f"{directory} is in use by another run; choose another --output"
            ) from error
        yield
    finally:
        os.close(handle)


def holds_run(directory: Path) -> bool:
    """Tell whether a run was begun in this directory."""
    return any((directory / name).exists() for name in (JOURNAL_FILE, "run.json"))


def clear_run(directory: Path) -> None:
    """Remove a run's files, and nothing else."""
    for name in RUN_FILES:
        (directory / name).unlink(missing_ok=True)
    shutil.rmtree(directory / "videos", ignore_errors=True)


def write_actions(records: Sequence[EpisodeRecord], directory: Path) -> None:
    """Write ``actions.npz``: per episode, by its key, float32 (T, A) as applied.

    Raises:
        RunDirectoryError: the file cannot be written.
    """
    partial = directory / f".{ACTIONS_FILE}.partial"
    try:
        arrays: dict[str, Any] = {record.spec.key: record.trace.actions for record in records}
        with partial.open("wb") as file:
            np.savez_compressed(file, **arrays)
        os.replace(partial, directory / ACTIONS_FILE)
    except OSError as error:
        raise RunDirectoryError(f"{partial} cannot be written: {error.strerror}") from error
