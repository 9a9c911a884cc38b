"""Fresh episodes: whether a policy does as well on seeds that nobody knew when it was made.

The official seeds are public, so a table of stored actions can succeed in all of their episodes.
The seed of fresh ones follows from the checkpoint and from a draw made after it was fixed.
"""

import hashlib
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Self

import numpy as np
import scipy

from minitouch_bench.episode import Episode, Role
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import mean_difference

SIGNIFICANCE = 0.01
"""Chance at most that an honest submission is refused. Half of it is for single comparisons
(Bonferroni), half for the drops of all tasks together."""

Group = tuple[Role, str, str]
"""A policy's role, a suite and a task."""

ORDERS = 200_000
"""Orders of the episodes that a permutation test counts."""


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
    p = len(drops) * float(min(combined, default=1.0))
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
