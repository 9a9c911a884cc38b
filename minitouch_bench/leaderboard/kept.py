"""What a build of the board keeps for the next one: each submission's row, by its digest.

The rows lie in ``.cache`` below the board, as JSON, and are never committed: anyone who can write
there can forge a row. Deleting the directory costs time and nothing else.
"""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

import minitouch_bench
from minitouch_bench.documents import read_json, write_json
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import ACTIONS_FILE, read_file, write_file
from minitouch_bench.leaderboard.inventory import (
    MAX_SUBMISSION_FILE,
    RUN_LIMITS,
    list_files,
    read_plain,
)
from minitouch_bench.leaderboard.proof import MAX_PROOF, proof_path
from minitouch_bench.leaderboard.scored import Refusal, ScoredSubmission
from minitouch_bench.leaderboard.submission import SUBMISSION_FILE
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.verification.problems import Problems

DIRECTORY = ".cache"
CODE = (".py", ".j2", ".css", ".js")
LIBRARIES = ("numpy", "scipy")


@dataclass(frozen=True)
class KeptRow:
    """A submission's row as it is kept: one of the two."""

    scored: ScoredSubmission | None
    refusal: Refusal | None


class KeptRows:
    """The rows of earlier builds of one board."""

    def __init__(self, board: Path) -> None:
        self._directory = board / DIRECTORY

    def find(self, digest: str) -> ScoredSubmission | Refusal | None:
        """Return the row that is kept under a digest, None if there is none to be read."""
        try:
            content = read_file(self._directory / f"{digest}.json")
            kept = read_json(content, KeptRow, digest)
        except (OSError, RunDirectoryError):
            return None
        return kept.scored or kept.refusal

    def keep(self, digest: str, found: ScoredSubmission | Refusal) -> None:
        """Keep a row.

        Raises:
            RunDirectoryError: it cannot be written.
        """
        kept = KeptRow(found, None) if isinstance(found, ScoredSubmission) else KeptRow(None, found)
        write_file(self._directory / f"{digest}.json", write_json(kept), durable=False)

    def forget_others(self, digests: Iterable[str]) -> None:
        """Remove every row but these, and have git ignore the rest."""
        names = {f"{digest}.json" for digest in digests}
        write_file(self._directory / ".gitignore", "*\n")
        for path in self._directory.glob("*.json"):
            if path.name not in names:
                path.unlink(missing_ok=True)


def submission_digest(directory: Path) -> str:
    """Return the SHA-256 over all that a submission's row depends on.

    That is the program and the protocol; the submission's name and place; the names and sizes of
    all its files, and the content of those that a board reads; and its proof, with the files
    that it is about.

    Raises:
        RunDirectoryError: the proof cannot be read.
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
    has_proof = proof.exists()
    yield read_plain(proof.parent, proof.name, MAX_PROOF) if has_proof else b""
    limits = {SUBMISSION_FILE: MAX_SUBMISSION_FILE, **RUN_LIMITS}
    for path in sorted(found):
        name = Path(path).name
        if name in limits and (has_proof or name != ACTIONS_FILE):
            try:
                yield read_plain(directory, path, limits[name])
            except RunDirectoryError as error:  # the submission is refused for it
                yield str(error).encode()


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
