"""The files of a submission: only known ones, plain, and no larger than they can honestly be."""

import hashlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

from minitouch_bench import files
from minitouch_bench.errors import UnreadableFileError
from minitouch_bench.leaderboard.submission import Submission
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

VIDEO = re.compile(rf"videos/(?:exploration-)?(?:{'|'.join(TASK_NAMES)})-\d{{1,4}}\.mp4")


def list_files(directory: Path, problems: Problems) -> dict[str, int]:
    """Return the size in bytes of every plain file by its path; nothing is followed or opened."""
    if not files.is_folder(directory):
        problems.add("", "it is a link, not a directory", "give the directory itself")
        return {}
    sizes: dict[str, int] = {}
    with problems.caught(""), files.os_errors_as(UnreadableFileError, directory, "read"):
        for entry in walk(directory):
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


def walk(directory: Path | str, depth: int = 0) -> Iterator[os.DirEntry[str]]:
    """Walk through all that lies in a directory, in order, down to MAX_DEPTH; follow no link."""
    with os.scandir(directory) as entries:
        for entry in sorted(entries, key=lambda entry: entry.name):
            yield entry
            if entry.is_dir(follow_symlinks=False) and depth < MAX_DEPTH - 1:
                yield from walk(entry.path, depth + 1)


def check_files(submission: Submission, sizes: dict[str, int], problems: Problems) -> None:
    """Hold the files against those that a submission has; the rest is unknown."""
    limits = {files.SUBMISSION_FILE: MAX_SUBMISSION_FILE}
    for seed in submission.seeds:
        for folder in seed.runs.values():
            for name, most in RUN_LIMITS.items():
                limits[f"{folder}/{name}"] = most
                if f"{folder}/{name}" not in sizes:
                    problems.add(f"{folder}/{name}", "it is missing", "pack the run again")
        for file in seed.checkpoints:
            if file.path:
                limits[file.path] = files.LARGEST_CHECKPOINT
                if file.path not in sizes:
                    problems.add(file.path, "it is missing", 'add it, or set its path to ""')
    folders = [folder for seed in submission.seeds for folder in seed.runs.values()]
    for path, size in sizes.items():
        limit = limits.get(path, MAX_VIDEO if _is_video(path, folders) else None)
        if limit is None:
            remedy = "remove it"
            if path.endswith(VIEWS):
                remedy += "; make tables and pages with minitouch-bench report"
            problems.add(path, "a submission has no such file", remedy)
        elif size > limit:
            problems.add(path, f"it has {size} bytes; the limit is {limit}", "make it smaller")


def check_videos(
    directory: Path, sizes: dict[str, int], folders: list[str], problems: Problems
) -> dict[str, str]:
    """Check that videos hold what their names say, and return the SHA-256 of each by its path.

    A leaderboard publishes them.
    """
    digests: dict[str, str] = {}
    for path, size in sizes.items():
        if _is_video(path, folders) and size <= MAX_VIDEO:
            with problems.caught(path):
                content = read_plain(directory, path, MAX_VIDEO)
                digests[path] = hashlib.sha256(content).hexdigest()
                if content[4:8] != MP4_MARK:
                    problems.add(path, "it is not an MP4 video", "record it again")
    return digests


def _is_video(path: str, folders: list[str]) -> bool:
    return any(
        path.startswith(f"{folder}/") and VIDEO.fullmatch(path[len(folder) + 1 :])
        for folder in folders
    )


def read_plain(directory: Path, path: str, limit: int) -> bytes:
    """Return the bytes of a submission's file, with an error that does not repeat its name.

    Raises:
        UnreadableFileError: it cannot be read, or is larger than ``limit``.
    """
    try:
        return files.read_file(directory / path, limit)
    except OSError as error:
        raise UnreadableFileError(f"it cannot be read: {error.strerror}") from error
