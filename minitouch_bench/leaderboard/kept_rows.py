"""What a board keeps of each submission, from one build to the next: its row, by its digest.

The rows lie in ``.cache`` below the board and are never committed: anyone who can write there can
forge a row. A submission is not read again while the sizes, inodes and times of its files and its
proof stay the same: anyone who can set these can hide a change. If the directory is deleted,
everything is read and computed again, and nothing else is lost.
"""

import hashlib
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path

import minitouch_bench
from minitouch_bench.documents import read_json, write_json
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import ACTIONS_FILE, SUBMISSION_FILE, read_file, write_file
from minitouch_bench.leaderboard.board import Refusal, ScoredSubmission
from minitouch_bench.leaderboard.inventory import (
    MAX_SUBMISSION_FILE,
    RUN_LIMITS,
    list_files,
    read_plain,
    walk,
)
from minitouch_bench.leaderboard.proof import MAX_PROOF, proof_path
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.verification.problems import Problems

DIRECTORY = ".cache"
SEEN = "seen"

SETTLED_NS = 2 * 10**9
"""Age of a file's last change from which on another one gets another time stamp."""

CODE = (".py", ".j2", ".css", ".js")

LIBRARIES = ("numpy", "scipy")


@dataclass(frozen=True)
class KeptRow:
    """A submission's row as it is kept: one of the two. Its page lies beside it."""

    scored: ScoredSubmission | None
    refusal: Refusal | None


@dataclass(frozen=True)
class Seen:
    """The submissions of a build by name: their ``file_state``, and their digest."""

    program: str
    submissions: Mapping[str, tuple[str, str]]


class KeptRows:
    """The rows of earlier builds of one board."""

    def __init__(self, board: Path) -> None:
        self._directory = board / DIRECTORY
        self._before = self._read_seen()
        self._now: dict[str, tuple[str, str]] = {}

    def digest(self, submission: Path) -> str:
        """Return ``submission_digest``, that of the last build where no file has changed."""
        state = file_state(submission)
        before, digest = self._before.get(submission.name, ("", ""))
        if not state or state != before:
            digest = submission_digest(submission)
        self._now[submission.name] = state, digest
        return digest

    def find(self, digest: str) -> ScoredSubmission | Refusal | None:
        """Return the row that is kept under a digest, None if there is none to be read."""
        try:
            kept = read_json(read_file(self._file(digest, "json")), KeptRow, digest)
            if kept.scored is None:
                return kept.refusal
            return replace(kept.scored, page=read_file(self._file(digest, "html")).decode())
        except (OSError, ValueError, RunDirectoryError):
            return None

    def keep(self, digest: str, found: ScoredSubmission | Refusal) -> None:
        """Keep a row.

        Raises:
            RunDirectoryError: it cannot be written.
        """
        if isinstance(found, ScoredSubmission):
            write_file(self._file(digest, "html"), found.page, durable=False)
            kept = KeptRow(replace(found, page=""), None)
        else:
            kept = KeptRow(None, found)
        write_file(self._file(digest, "json"), write_json(kept), durable=False)

    def finish(self) -> None:
        """Remove every row but those of this build, note what was seen, and have git ignore all.

        Raises:
            RunDirectoryError: a file cannot be written.
        """
        seen = Seen(_program_digest().hex(), self._now)
        write_file(self._directory / SEEN, write_json(seen), durable=False)
        write_file(self._directory / ".gitignore", "*\n")
        digests = {digest for _, digest in self._now.values()}
        for path in self._directory.glob("*.*"):
            if path.stem not in digests and path.name != ".gitignore":
                path.unlink(missing_ok=True)

    def _read_seen(self) -> Mapping[str, tuple[str, str]]:
        try:
            seen = read_json(read_file(self._directory / SEEN), Seen, SEEN)
        except (OSError, RunDirectoryError):
            return {}
        return seen.submissions if seen.program == _program_digest().hex() else {}

    def _file(self, digest: str, ending: str) -> Path:
        return self._directory / f"{digest}.{ending}"


def file_state(directory: Path) -> str:
    """Return what differs once a file of a submission or its proof changes, without reading any.

    "" where one has changed so lately that it could change again at the same time stamp.
    """
    resolved = directory.resolve()
    proof = proof_path(resolved)
    sha = hashlib.sha256(f"{resolved.parent.name} {directory.is_symlink()}\n".encode())
    try:
        found = [(entry.path, entry.stat(follow_symlinks=False)) for entry in walk(directory)]
        if os.path.lexists(proof):
            found.append((str(proof), proof.lstat()))
    except OSError:  # the reader of the submission says what is wrong
        return ""
    for path, now in found:
        times = (now.st_mtime_ns, now.st_ctime_ns)
        sha.update(os.fsencode(path))
        sha.update(str((now.st_mode, now.st_ino, now.st_size, *times)).encode())
    newest = max((now.st_ctime_ns for _, now in found), default=0)
    return sha.hexdigest() if newest < time.time_ns() - SETTLED_NS else ""


def submission_digest(directory: Path) -> str:
    """Return the SHA-256 over all that a submission's row depends on.

    That is the program and the protocol; the submission's name and place; the names and sizes of
    all its files, and the content of those that a board reads; and its proof, with the files
    that it is about.
    """
    sha = hashlib.sha256(_program_digest())
    for part in _parts(directory):
        sha.update(hashlib.sha256(part).digest())
    return sha.hexdigest()


def _parts(directory: Path) -> Iterator[bytes]:
    problems = Problems()
    found = list_files(directory, problems)
    yield str((directory.resolve().parent.name, directory.name, sorted(found.items()))).encode()
    yield str(list(map(str, problems))).encode()
    proof = proof_path(directory.resolve())
    has_proof = os.path.lexists(proof)
    yield _content(proof.parent, proof.name, MAX_PROOF) if has_proof else b""
    limits = {SUBMISSION_FILE: MAX_SUBMISSION_FILE, **RUN_LIMITS}
    for path in sorted(found):
        name = Path(path).name
        if name in limits and (has_proof or name != ACTIONS_FILE):
            yield _content(directory, path, limits[name])


def _content(directory: Path, place: str, limit: int) -> bytes:
    """Return a file's content, or the reason why a board does not read it."""
    try:
        return read_plain(directory, place, limit)
    except RunDirectoryError as error:
        return str(error).encode()


@cache
def _program_digest() -> bytes:
    """Return a digest of the package's code, of the protocol and of what computes with them."""
    sha = hashlib.sha256(PROTOCOL.digest().encode())
    sha.update(str([version(name) for name in LIBRARIES]).encode())
    root = Path(minitouch_bench.__file__).parent
    for path in sorted(root.rglob("*")):
        if path.suffix in CODE:
            sha.update(hashlib.sha256(read_file(path)).digest())
    return sha.digest()
