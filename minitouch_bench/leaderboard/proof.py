"""How well a submission's figures are proved, and the maintainer's note that says so.

A proof lies beside the submissions, in ``_proofs/NAME.json``, never inside one: a change that
adds a submission has no reason to touch it. It binds a level to the bytes of each run and of
``submission.toml``, which has the digests of the checkpoints.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from minitouch_bench.documents import read_json, write_json
from minitouch_bench.errors import RunDirectoryError, UnreadableFileError
from minitouch_bench.files import os_errors_as, read_file, write_file
from minitouch_bench.records import Count
from minitouch_bench.runs.run import Run
from minitouch_bench.verification.fresh import FreshResult

PROOFS = "_proofs"
"""A submission's name begins with a letter or digit, so none can be called this."""

MAX_PROOF = 2**16

MIN_FRESH_EPISODES = 20
"""Fresh episodes per task below which there is no level: a large drop could be chance."""


class ProofLevel(StrEnum):
    """What stands behind a row's figures, from the weakest up; ``remote`` stands apart."""

    SELF_REPORTED = "self-reported"
    REPLAYED = "replay-verified"
    RERUN = "re-run-verified"
    FRESH = "fresh-verified"
    REMOTE = "remote"


PROVED_LEVELS = (ProofLevel.REPLAYED, ProofLevel.RERUN, ProofLevel.FRESH)
"""The levels that a maintainer's proof can give."""
RANKED_LEVELS = (ProofLevel.RERUN, ProofLevel.FRESH)
"""The levels whose rows have a rank."""

MEANINGS: Mapping[ProofLevel, str] = {
    ProofLevel.SELF_REPORTED: "the submitter's own figures, consistent with their episodes",
    ProofLevel.REPLAYED: "a maintainer replayed the recorded actions: the simulator gives "
    "exactly these figures",
    ProofLevel.RERUN: "a maintainer also ran drawn episodes with the checkpoint: the same actions",
    ProofLevel.FRESH: "and ran new episodes, drawn after the checkpoint was fixed: no worse",
    ProofLevel.REMOTE: "the actions came from a server: nobody else can run this policy",
}


@dataclass(frozen=True)
class FreshProof:
    """The fresh episodes of a proof, which anybody can repeat.

    ``draw``: what ``fresh_seed`` was given beside each checkpoint. ``seeds`` and ``results`` are
    those of each run, by its path in the submission.
    """

    draw: str
    episodes_per_task: Count
    seeds: Mapping[str, int]
    results: Mapping[str, tuple[FreshResult, ...]]


@dataclass(frozen=True)
class Proof:
    """What a maintainer has proved: the level, and the digests of the files it holds for."""

    level: ProofLevel
    files: Mapping[str, str]
    rerun_episodes: Count
    package: str
    fresh: FreshProof | None = None
    format: Literal["minitouch-proof"] = "minitouch-proof"
    version: Literal[1] = 1

    @property
    def strength(self) -> tuple[int, int, int]:
        """What orders proofs: level, fresh episodes per task, episodes that were run again."""
        fresh = self.fresh.episodes_per_task if self.fresh else 0
        return PROVED_LEVELS.index(self.level), fresh, self.rerun_episodes


def make_proof(
    files: Mapping[str, str],
    level: ProofLevel,
    rerun_episodes: int = 0,
    fresh: FreshProof | None = None,
) -> Proof:
    """Bind a level to a submission's ``Verdict.files``."""
    return Proof(level, files, rerun_episodes, version("minitouch-bench"), fresh)


def proof_path(directory: Path) -> Path:
    """Return where the proof of a submission lies: beside the submissions."""
    place = Path(os.path.realpath(directory))  # resolve() fails at a link to itself
    return place.parent / PROOFS / f"{place.name}.json"


def write_proof(proof: Proof, path: Path) -> None:
    """Write a proof as a whole.

    Raises:
        RunDirectoryError: it cannot be written.
    """
    write_file(path, write_json(proof))


def withdraw_proof(path: Path) -> None:
    """Remove a proof.

    Raises:
        RunDirectoryError: it cannot be removed.
    """
    with os_errors_as(RunDirectoryError, path, "removed"):
        path.unlink(missing_ok=True)


def read_proof(path: Path) -> Proof | None:
    """Read a proof, None where there is none.

    Raises:
        RunDirectoryError: the file is something else.
    """
    if not os.path.lexists(path):
        return None
    with os_errors_as(UnreadableFileError, path, "read"):
        content = read_file(path, MAX_PROOF)
    proof = read_json(content, Proof, str(path))
    if proof.level not in PROVED_LEVELS:
        raise RunDirectoryError(f"{path}: the level {proof.level} needs no proof")
    return proof


def find_proof(directory: Path, files: Mapping[str, str]) -> Proof | None:
    """Return the proof of a submission's ``Verdict.files``, None where none can be read."""
    try:
        proof = read_proof(proof_path(directory))
    except RunDirectoryError:
        return None
    return proof if proof and files and proof.files == files else None


def level_of(runs: Mapping[str, Run], proof: Proof | None) -> ProofLevel:
    """Return the level of a submission with these runs and this ``find_proof``.

    A remote policy stays "remote" whatever was replayed: nobody else can run it. A submission is
    "fresh-verified" where each of its runs was compared with enough fresh episodes.
    """
    if any(policy.kind == "remote" for run in runs.values() for policy in run.header.policies()):
        return ProofLevel.REMOTE
    if proof is None:
        return ProofLevel.SELF_REPORTED
    if proof.level is ProofLevel.FRESH and not _is_fresh(runs, proof.fresh):
        return ProofLevel.RERUN
    return proof.level


def _is_fresh(runs: Mapping[str, Run], fresh: FreshProof | None) -> bool:
    return (
        fresh is not None
        and fresh.episodes_per_task >= MIN_FRESH_EPISODES
        and fresh.results.keys() >= runs.keys()
    )
