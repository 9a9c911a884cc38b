"""The files of a submission: known plain files of honest sizes, none of which is executed."""

import hashlib
import os
import re
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath

from minitouch_bench import files
from minitouch_bench.errors import UnreadableFileError
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    CheckpointFile,
    Submission,
    TrainingSeed,
)
from minitouch_bench.policies.policy import FORMATS, KIND_BY_SUFFIX
from minitouch_bench.policies.sources import check_zip
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.verification.problems import Problems

RUN_LIMITS = {files.RUN_FILE: 4 * files.MIB, files.ACTIONS_FILE: 12 * files.MIB}
"""The files that each run in a submission has, beside videos, and the most bytes of each."""

VIEWS = (".csv", ".md", ".html")
"""Endings of files that are written for people: of a run's facts, and not among them."""

MAX_SUBMISSION_FILE = 64 * files.KIB
MP4_MARK = b"ftyp"
"""What an MP4 file has at its fifth byte."""
MAX_VIDEO = 20 * files.MIB
MAX_FILES = 2000
MAX_DEPTH = 4

VIDEO = re.compile(rf"(?:exploration-)?(?:{'|'.join(TASK_NAMES)})-\d{{1,4}}\.mp4")


def list_files(directory: Path, problems: Problems) -> dict[str, int]:
    """Return the size in bytes of every plain file by its path; nothing is followed or opened."""
    sizes: dict[str, int] = {}
    with problems.caught(""), files.os_errors_as(UnreadableFileError, directory, "read"):
        if not directory.is_dir():
            problems.add("", "it is not a directory", "give a submission's directory")
        elif not files.is_folder(directory):
            problems.add("", "it is a link, not a directory", "give the directory itself")
        for entry in () if problems else _walk(directory):
            path = entry.path[len(str(directory)) + 1 :]
            status = entry.stat(follow_symlinks=False)
            if stat.S_ISLNK(status.st_mode):
                problems.add(path, "it is a symbolic link", "put the file itself there")
            elif stat.S_ISREG(status.st_mode):
                sizes[path] = status.st_size
            elif not stat.S_ISDIR(status.st_mode):
                problems.add(path, "it is no plain file", "remove it")
            elif path.count("/") >= MAX_DEPTH - 1:
                what = f"it is a directory more than {MAX_DEPTH} levels deep"
                problems.add(path, what, "remove it")
            if len(sizes) > MAX_FILES:
                problems.add("", f"it has more than {MAX_FILES} files", "remove some")
                break
    return sizes


def _walk(directory: Path | str, depth: int = 0) -> Iterator[os.DirEntry[str]]:
    """Walk through all that lies in a directory, in order, down to MAX_DEPTH; follow no link."""
    with os.scandir(directory) as entries:
        for entry in sorted(entries, key=lambda entry: entry.name):
            yield entry
            if entry.is_dir(follow_symlinks=False) and depth < MAX_DEPTH - 1:
                yield from _walk(entry.path, depth + 1)


def read_plain(directory: Path, path: str, limit: int) -> bytes:
    """Return the bytes of a submission's file, with an error that does not repeat its name.

    Raises:
        UnreadableFileError: it cannot be read, or is larger than ``limit``.
    """
    try:
        return files.read_file(directory / path, limit)
    except OSError as error:
        raise UnreadableFileError(f"it cannot be read: {error.strerror}") from error


def check_files(
    directory: Path, submission: Submission, sizes: Mapping[str, int], problems: Problems
) -> dict[str, str]:
    """Compare the files with those that a submission has, and return its videos' SHA-256 by path.

    A leaderboard publishes the videos, so each must be what its name says.
    """
    folders = [folder for seed in submission.seeds for folder in seed.runs.values()]
    limits = {files.SUBMISSION_FILE: MAX_SUBMISSION_FILE}
    limits |= {f"{folder}/{name}": most for folder in folders for name, most in RUN_LIMITS.items()}
    listed = (file for seed in submission.seeds for file in seed.checkpoints)
    checkpoints = {file.path for file in listed if file.path and not file.is_reference}
    limits |= dict.fromkeys(checkpoints, files.LARGEST_CHECKPOINT)
    for path in [path for path in limits if path not in sizes]:
        remedy = 'add it, or set its path to ""' if path in checkpoints else "pack the run again"
        problems.add(path, "it is missing", remedy)
    digests: dict[str, str] = {}
    for path, size in sizes.items():
        folder, _, name = path.partition(f"/{files.VIDEOS}/")
        is_video = folder in folders and VIDEO.fullmatch(name)
        limit = MAX_VIDEO if is_video else limits.get(path)
        if limit is None:
            more = "; make tables and pages with minitouch-bench report"
            remedy = f"remove it{more if path.endswith(VIEWS) else ''}"
            problems.add(path, "a submission has no such file", remedy)
        elif size > limit:
            problems.add(path, f"it has {size} bytes; the limit is {limit}", "make it smaller")
        elif is_video:
            with problems.caught(path):
                content = read_plain(directory, path, MAX_VIDEO)
                digests[path] = hashlib.sha256(content).hexdigest()
                if content[4:8] != MP4_MARK:
                    problems.add(path, "it is not an MP4 video", "record it again")
    return digests


def check_checkpoints(
    directory: Path, seed: TrainingSeed, sizes: Mapping[str, int], problems: Problems
) -> None:
    """Check the names of a training seed's files, and the bytes of those that are there."""
    for file in seed.checkpoints:
        name = PurePosixPath(file.file)
        kind = KIND_BY_SUFFIX.get(name.suffix)
        if file.file and kind is None:
            remedy = f"a checkpoint ends in {', '.join(KIND_BY_SUFFIX)}"
            problems.add(file.file, "it is not a checkpoint", remedy)
        if file.task not in (ALL_TASKS, name.stem):
            problems.add(file.file, f"it is not named after its task {file.task}", "rename it")
        if file.path not in sizes:
            continue
        with problems.caught(file.path):
            content = read_plain(directory, file.path, files.LARGEST_CHECKPOINT)
            check_content(file, content, problems)


def check_content(file: CheckpointFile, content: bytes, problems: Problems) -> None:
    """Compare a checkpoint's bytes with what the submission says of it.

    Raises:
        PolicyLoadError: it is a zip that unpacks to far more than it holds.
    """
    if hashlib.sha256(content).hexdigest() != file.sha256:
        what = "its SHA-256 is not that of submission.toml"
        problems.add(file.path, what, "name or put there the file that was evaluated")
    kind = KIND_BY_SUFFIX.get(PurePosixPath(file.file).suffix)
    if kind is not None and FORMATS[kind].is_zip:
        check_zip(content, file.file)
