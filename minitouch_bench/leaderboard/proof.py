"""How well a submission's figures are proved, and the maintainer's note that says so.

A proof lies beside the submissions, in ``_proofs/NAME.json``, never inside one: a change that
adds a submission has no reason to touch it. It binds a level to the bytes of each run and of
``submission.toml``, which has the digests of the checkpoints.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Literal

from minitouch_bench.episode import Count
from minitouch_bench.errors import RunDirectoryError, UnreadableFileError
from minitouch_bench.files import VIDEOS, os_errors_as, read_file
from minitouch_bench.json_io import read_json
from minitouch_bench.runs.run import Run
from minitouch_bench.verification.fresh import FreshResult

PROOFS = "_proofs"
"""A submission's name begins with a letter or digit, so none can be called this."""

MAX_PROOF = 2**16

MIN_FRESH_EPISODES = 20
"""Fresh episodes per task below which there is no level: a large drop could be chance."""


class ProofLevel(StrEnum):
    """How well a row's estimates are proved, from the weakest level up."""

    SELF_REPORTED = "self-reported"
    REPLAYED = "replayed"
    VERIFIED = "verified"

    @classmethod
    def _missing_(cls, value: object) -> "ProofLevel | None":
        """Read the levels that proofs had before there were three."""
        return EARLIER_LEVELS.get(str(value))


EARLIER_LEVELS: Mapping[str, ProofLevel] = {
    "replay-verified": ProofLevel.REPLAYED,
    "re-run-verified": ProofLevel.REPLAYED,
    "fresh-verified": ProofLevel.VERIFIED,
    "remote": ProofLevel.SELF_REPORTED,
}

MEANINGS: Mapping[ProofLevel, str] = {
    ProofLevel.SELF_REPORTED: "the submitter's own figures, consistent with their episodes",
    ProofLevel.REPLAYED: "a maintainer replayed the recorded actions: the simulator gives exactly "
    "these figures; a policy server cannot reach more",
    ProofLevel.VERIFIED: "a maintainer also ran sampled episodes with the checkpoint, which gave "
    "the same actions, and new ones, generated after it was fixed, which are no worse",
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
    """What a maintainer has proved: the level, and the digests of the files it holds for.

    Version 1 did not cover videos: it holds whichever the submission has.
    """

    level: ProofLevel
    files: Mapping[str, str]
    rerun_episodes: Count = 0
    fresh: FreshProof | None = None
    package: str = field(default_factory=partial(metadata.version, "minitouch-bench"))
    format: Literal["minitouch-proof"] = "minitouch-proof"
    version: Literal[1, 2] = 2

    def covers(self, files: Mapping[str, str]) -> bool:
        """Return whether it is a proof of these very bytes, and of no others."""
        covered = {
            path: digest
            for path, digest in files.items()
            if self.version > 1 or f"/{VIDEOS}/" not in path
        }
        return bool(files) and self.files == covered


def proof_path(directory: Path) -> Path:
    """Return where the proof of a submission lies: beside the submissions."""
    place = Path(os.path.realpath(directory))  # resolve() fails at a link to itself
    return place.parent / PROOFS / f"{place.name}.json"


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
    if proof.level is ProofLevel.SELF_REPORTED:
        raise RunDirectoryError(f"{path}: the level {proof.level} needs no proof")
    return proof


def find_proof(directory: Path, files: Mapping[str, str]) -> Proof | None:
    """Return the proof of a submission's files, None where none can be read."""
    try:
        proof = read_proof(proof_path(directory))
    except RunDirectoryError:
        return None
    return proof if proof and proof.covers(files) else None


def level_of(runs: Mapping[str, Run], proof: Proof | None) -> ProofLevel:
    """Return the level of a submission with these runs and this ``find_proof``.

    It is "verified" where each run was compared with enough fresh episodes of policies that a
    maintainer can run.
    """
    if proof is None:
        return ProofLevel.SELF_REPORTED
    fresh = proof.fresh
    is_verified = (
        proof.level is ProofLevel.VERIFIED
        and fresh is not None
        and fresh.episodes_per_task >= MIN_FRESH_EPISODES
        and fresh.results.keys() >= runs.keys()
        and can_be_run(runs)
    )
    return ProofLevel.VERIFIED if is_verified else ProofLevel.REPLAYED


def can_be_run(runs: Mapping[str, Run]) -> bool:
    """Return whether a maintainer can run the policies: neither a server's nor Python classes."""
    policies = (policy for run in runs.values() for policy in run.header.policies())
    return not any(policy.kind in ("remote", "factory") for policy in policies)
