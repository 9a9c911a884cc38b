"""What a board keeps of each submission, from one build to the next: its row, by its digest.

The rows lie in ``.cache`` below the board, as JSON, and are never committed: anyone who can write
there can forge a row. Deleting the directory costs time and nothing else.
"""

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

import minitouch_bench
from minitouch_bench.documents import read_json, write_json
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import ACTIONS_FILE, read_file, write_file
from minitouch_bench.leaderboard.entries import Ending
from minitouch_bench.leaderboard.inventory import (
    MAX_SUBMISSION_FILE,
    RUN_LIMITS,
    list_files,
    read_plain,
)
from minitouch_bench.leaderboard.proof import MAX_PROOF, FreshProof, ProofLevel, proof_path
from minitouch_bench.leaderboard.submission import SUBMISSION_FILE, Submission
from minitouch_bench.policies.loading import BUILT_IN
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import Estimate, Gap
from minitouch_bench.verification.problems import Problems

DIRECTORY = ".cache"

CODE = (".py", ".j2", ".css", ".js")

LIBRARIES = ("numpy", "scipy")


@dataclass(frozen=True)
class ScoredSubmission:
    """All that a board shows of one submission and that no other one changes, as plain JSON.

    ``runs``: the digest of each run by its path. ``figures`` by task or "overall", then by
    metric; ``gaps`` by task; ``endings``: number of episodes by task and ending. ``values`` by
    task: of each training seed, the episodes' values in the metric that ranks the task.
    ``videos`` are paths in the submission. ``page`` is its page, with marks where the ranks
    stand. ``sketches``: see ``twins.sketch_of``; only a proof has them.
    """

    about: Submission
    level: ProofLevel
    rerun_episodes: int
    fresh: FreshProof | None
    sketches: Mapping[str, tuple[float, ...]]
    runs: Mapping[str, str]
    figures: Mapping[str, Mapping[str, Estimate]]
    gaps: Mapping[str, Gap]
    endings: Mapping[str, Mapping[Ending, int]]
    values: Mapping[str, tuple[tuple[float, ...], ...]]
    videos: tuple[str, ...]
    page: str = ""

    @property
    def name(self) -> str:
        """The submission's name."""
        return self.about.name

    @property
    def is_calibration(self) -> bool:
        """Whether it is one of the built-in policies, which are shown and never ranked."""
        return self.name in BUILT_IN

    def estimate(self, task: str, metric: str) -> Estimate | None:
        """Return an estimate, None where there is none."""
        return self.figures.get(task, {}).get(metric)


@dataclass(frozen=True)
class Refusal:
    """A submission that is not on the board, with every reason."""

    name: str
    reasons: tuple[str, ...]
    is_other_protocol: bool


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
