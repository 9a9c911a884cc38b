"""Fresh episodes: whether a policy does as well on seeds that nobody knew when it was made.

The official seeds are public, so a table of stored actions can succeed in all of their episodes.
The seed of fresh ones follows from the checkpoint and from a draw made after it was fixed.
"""

import hashlib
import secrets
from collections.abc import Sequence
from dataclasses import dataclass

import scipy

from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.records import EpisodeMetrics, Role

SIGNIFICANCE = 0.01
"""Chance at most that an honest submission is refused. Half of it is for single comparisons
(Bonferroni), half for the drops of a training seed together."""


def new_draw() -> str:
    """Return 128 random bits in hexadecimal."""
    return secrets.token_hex(16)


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


def compare_fresh(
    official: Sequence[EpisodeMetrics], fresh: Sequence[EpisodeMetrics], role: Role, task: str
) -> FreshResult:
    """Compare a task's episodes, one-sided, by Fisher's or Mann and Whitney's test."""
    metric = METRICS[ranking_metric(task)]
    before, after = metric.values(official), metric.values(fresh)
    if {*before, *after} <= {0.0, 1.0}:
        table = [[sum(values), len(values) - sum(values)] for values in (before, after)]
        p = scipy.stats.fisher_exact(table, alternative="greater").pvalue
    else:
        p = scipy.stats.mannwhitneyu(before, after, alternative="greater").pvalue
    means = (sum(before) / len(before), sum(after) / len(after))
    return FreshResult(role, task, metric.name, *means, len(after), float(p))


def significant_drops(results: Sequence[FreshResult], planned: int) -> tuple[FreshResult, ...]:
    """Return the results, of so many planned, that an honest policy would hardly give."""
    return tuple(result for result in results if result.p < SIGNIFICANCE / 2 / planned)


def drop_together(by_seed: Sequence[Sequence[FreshResult]]) -> float | None:
    """Return the p-value of a training seed's drops together if they are significant.

    ``by_seed``: each training seed's comparisons in the tasks that are ranked. A small drop in
    every task is seen so. Tasks have different episodes; training seeds play the same scenes, so
    they are corrected for their number (Bonferroni).

    Source: R. A. Fisher, "Statistical Methods for Research Workers" (1932), combined p-values.
    """
    tests = (
        scipy.stats.combine_pvalues([result.p for result in results], method="fisher")
        for results in by_seed
    )
    p = len(by_seed) * min(float(test.pvalue) for test in tests)
    return p if p < SIGNIFICANCE / 2 else None
