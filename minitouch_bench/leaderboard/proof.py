"""How well a submission's figures are proved, and the maintainer's note that says so.

A proof lies beside the submissions, in ``_proofs/NAME.json``, never inside one: a change that
adds a submission has no reason to touch it. It binds a level to the bytes of each run and of
``submission.toml``, which has the digests of the checkpoints.

The official seeds are public, so a table of stored actions can succeed in all of their episodes.
The seed of fresh ones follows from the checkpoint and from a draw made after it was fixed.
"""

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property, partial
from importlib import metadata
from operator import attrgetter
from pathlib import Path
from typing import Literal, Self

import numpy as np
import scipy

from minitouch_bench.episode import Count, Episode, Role
from minitouch_bench.errors import RunDirectoryError, UnreadableFileError
from minitouch_bench.files import VIDEOS, os_errors_as, read_file
from minitouch_bench.json_io import read_json
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import mean_difference
from minitouch_bench.runs.run import Run

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


# Fresh episodes

SIGNIFICANCE = 0.01
"""Chance at most that an honest submission is refused. Half of it is for single comparisons
(Bonferroni), half for the drops of all tasks together."""

Group = tuple[Role, str, str]
"""A policy's role, a suite and a task."""

ORDERS = 200_000
"""Orders of the episodes that a permutation test counts."""


def fresh_seed(checkpoint: str, draw: str) -> int:
    """Return SHA-256 over checkpoint and draw: the seed of fresh episodes, 0 to 2^256 - 1."""
    return int.from_bytes(hashlib.sha256(f"{checkpoint} {draw}".encode()).digest(), "big")


@dataclass(frozen=True)
class FreshResult:
    """A task's official episodes beside fresh ones, by the metric that it is ranked by.

    ``p``: how likely a drop as large is if both are draws of the same policy's episodes.
    """

    role: Role
    task: str
    metric: str
    official: float
    fresh: float
    episodes: int
    p: float

    def __str__(self) -> str:
        return (
            f"{self.metric} {self.official:.3f} officially, {self.fresh:.3f} in "
            f"{self.episodes} fresh episodes (p = {self.p:.2g})"
        )


@dataclass(frozen=True)
class Values:
    """What ranks a task: the values of a policy's official episodes, and those of fresh ones."""

    official: tuple[float, ...]
    fresh: tuple[float, ...]

    @classmethod
    def of(cls, task: str, official: Sequence[Episode], fresh: Sequence[Episode]) -> Self:
        """Take the metric that ranks a task from its episodes."""
        metric = METRICS[ranking_metric(task)]
        return cls(tuple(metric.values(official)), tuple(metric.values(fresh)))

    @cached_property
    def p(self) -> float:
        """How likely the mean drops as much where both are draws of the same episodes.

        One-sided: Fisher's exact test of shares, a permutation test of other means.
        """
        before, after = self.official, self.fresh
        if {*before, *after} <= {0.0, 1.0}:
            table = [[sum(values), len(values) - sum(values)] for values in (before, after)]
            return float(scipy.stats.fisher_exact(table, alternative="greater").pvalue)
        test = scipy.stats.permutation_test(
            (before, after), mean_difference, n_resamples=ORDERS, batch=2_000, vectorized=True,
            alternative="greater", rng=np.random.default_rng(0),
        )  # fmt: skip
        return float(test.pvalue)


def compare_fresh(values: Values, role: Role, task: str) -> FreshResult:
    """Compare a policy's official and fresh episodes of a task."""
    before, after = values.official, values.fresh
    means = (sum(before) / len(before), sum(after) / len(after))
    return FreshResult(role, task, ranking_metric(task), *means, len(after), values.p)


def significant_drops(results: Sequence[FreshResult], planned: int) -> tuple[FreshResult, ...]:
    """Return the results, of so many planned, that an honest policy would hardly give."""
    return tuple(result for result in results if result.p < SIGNIFICANCE / 2 / planned)


def drop_together(groups: Mapping[Group, Sequence[Values]]) -> float | None:
    """Return the p-value of the drops in all suites and tasks together if it is significant.

    ``groups``: of each policy, suite and task, the values of every training seed. A small drop in
    every task or in every seed is seen so. Final and exploration policies play the same scenes, so
    their p-values are not combined; the smaller one counts twice (Bonferroni).

    Source: R. A. Fisher, "Statistical Methods for Research Workers" (1932), combined p-values.
    """
    drops: dict[Role, list[float]] = {}
    for (role, _, _), seeds in groups.items():
        drops.setdefault(role, []).append(_seeds_drop(seeds))
    combined = [scipy.stats.combine_pvalues(p, method="fisher").pvalue for p in drops.values()]
    p = max(1, len(drops)) * float(min(combined, default=1.0))
    return p if p < SIGNIFICANCE / 2 else None


def _seeds_drop(seeds: Sequence[Values]) -> float:
    """Return the p-value of the drop of what a task is ranked by, the mean over training seeds.

    All seeds play the same official scenes, and each its own fresh ones, so an observation is the
    mean of the seeds' episodes of one number.
    """
    if len(seeds) == 1:
        return seeds[0].p
    official, fresh = ([*map(attrgetter(side), seeds)] for side in ("official", "fresh"))
    return Values(tuple(np.mean(official, axis=0)), tuple(np.mean(fresh, axis=0))).p


# The note


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
    return all(p.is_code_known for run in runs.values() for p in run.header.policies())
