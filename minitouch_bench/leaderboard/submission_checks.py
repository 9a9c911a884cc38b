"""What a submission may contain: known plain files of honest sizes, and official runs."""

import hashlib
import os
import re
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

from minitouch_bench import files
from minitouch_bench.episode import PolicyIdentity, Role
from minitouch_bench.errors import UnreadableFileError
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    CheckpointFile,
    Submission,
    TrainingSeed,
)
from minitouch_bench.policies.policy import FORMATS, Isolation
from minitouch_bench.policies.sources import DIRECTORY, NOTES, directory_digest
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.runs.run import Run, RunHeader
from minitouch_bench.verification.problems import Problems
from minitouch_bench.verification.static_check import AS_WRITTEN, RUN_AGAIN, check_run

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


KINDS = (*FORMATS, "scripted", DIRECTORY)
MAX_TEXT = 1000
MAX_NAMED = 50
"""Packages, or facts of the machine, that an honest run may name."""


def check_submitted(
    run: Run, suite: str, seed: TrainingSeed, path: str, problems: Problems, *, recompute: bool
) -> None:
    """Check a run by itself, and against what the submission says of it.

    Of a run of another suite, or that is not official, nothing more can be said. ``recompute``:
    see ``check_run``.
    """
    header = run.header
    if header.plan.suite != suite:
        what = f"it is a run of the suite '{header.plan.suite}', not {suite}"
        problems.add(path, what, RUN_AGAIN)
        return
    if not header.official:
        reasons = "; ".join(header.unofficial_because)
        problems.add(path, f"it is unofficial: {reasons}", f"evaluate the whole suite {suite}")
        return
    _check_texts(run, path, problems)
    with problems.caught(path, AS_WRITTEN):
        for problem in check_run(run, recompute=recompute):
            problems.add_below(path, problem)
            if problem.is_other_protocol:
                return
    check_policies(header, seed, path, problems)


def check_policies(header: RunHeader, seed: TrainingSeed, path: str, problems: Problems) -> None:
    """Check the policies that a run's header names: all that is known before its episodes."""
    _check_policy(header.policy, seed.files(Role.FINAL), path, problems)
    if header.exploration is not None:
        _check_policy(header.exploration, seed.files(Role.EXPLORATION), path, problems)
        if header.exploration.kind == "scripted" != header.policy.kind:
            problems.add(path, "its exploration is the scripted policy's, which reads the state")
    for policy in header.policies():
        _check_lengths((policy.name, policy.source), path, problems)
    if header.isolation == Isolation.NONE and header.policy.kind != "scripted":
        problems.add(
            path,
            "the policy ran beside the simulator (isolation none), which it could read",
            "evaluate with --isolation sandbox",
        )


def _check_policy(
    policy: PolicyIdentity, files: Sequence[CheckpointFile], path: str, problems: Problems
) -> None:
    """Hold a policy against the checkpoint files that the submission names for it."""
    if policy.kind not in KINDS:
        problems.add(path, f"'{policy.kind}' is no kind of policy", AS_WRITTEN)
        return
    if policy.notes != NOTES.get(policy.kind, ()):
        problems.add(path, f"a {policy.kind} policy lacks its label, or has another's", AS_WRITTEN)
    if policy.digest != files_digest(policy.kind, files):
        problems.add(
            path,
            f"the policy '{policy.name}' is not the checkpoints of submission.toml: "
            "their SHA-256 differ",
            "name the files that were evaluated, with their SHA-256",
        )


def files_digest(kind: str, files: Sequence[CheckpointFile]) -> str:
    """Return the digest that a run records of these files."""
    if kind == DIRECTORY:
        return directory_digest((file.file, file.sha256) for file in files)
    if len(files) == 1 and files[0].task == ALL_TASKS:
        return files[0].sha256
    return "several files" if files else ""


def _check_texts(run: Run, path: str, problems: Problems) -> None:
    """Refuse texts beyond any honest length; all are escaped wherever they are shown."""
    environment = run.environment
    texts = [run.header.protocol_digest, environment.started, *run.faults.values()]
    for named in (environment.packages, environment.machine):
        texts += [*named.keys(), *named.values()]
        if len(named) > MAX_NAMED:
            problems.add(path, f"its environment names {len(named)} things", AS_WRITTEN)
    _check_lengths(texts, path, problems)


def _check_lengths(texts: Sequence[str], path: str, problems: Problems) -> None:
    longest = max(map(len, texts))
    if longest > MAX_TEXT:
        problems.add(
            path, f"a text in it has {longest} characters; the limit is {MAX_TEXT}", AS_WRITTEN
        )
