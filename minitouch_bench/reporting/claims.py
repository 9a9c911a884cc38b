"""Claims of a study: that a method is better than others, judged over training seeds.

The study's file lists them before the first training. Together they are one family of tests for
Holm's correction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Final, Literal

import numpy as np
import pandas as pd
import scipy

from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.metric import DOWN, NO_DIRECTION
from minitouch_bench.metrics.significance import ALPHA, POWER, holm
from minitouch_bench.rendering.tables import ABSENT, Table, format_value, make_columns, make_row
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.long_frame import select
from minitouch_bench.reporting.paper import PAPER_METHODS, paper_value

CONFIRMED: Final = "confirmed"
CONTRADICTED: Final = "contradicted"
UNDECIDED: Final = "not decided"
WAITING: Final = "waiting"

LEAST_SEEDS: Final = 5
"""Training seeds per method below which nothing is decided."""

ORDERS_TRIED: Final = 200_000
"""Orders of the values that a test counts: all up to ten seeds per method, else random ones."""

SIMULATED: Final = 2_000
"""Pairs of methods in which a power is counted."""

LARGEST_SHIFT: Final = 50.0
"""Standard deviations; a test that does not detect these has no power at all."""

IN_PAPER: Final = dict(zip(("hac", "rnd-touch", "rnd"), PAPER_METHODS, strict=True))
"""What the paper's Table 4 calls our methods."""

NOTES: Final = (
    "One-sided exact Mann-Whitney tests; the unit is the training seed. They ask whether the "
    "values of one method tend to be larger, which is not a test of the means where methods vary "
    "unequally. A claim with several comparisons has the largest of their p-values. p: adjusted "
    f"by Holm's method over all claims of this table. Confirmed: p ≤ {ALPHA}. Contradicted: the "
    f"reverse of every comparison has p ≤ {ALPHA}, with the same correction. The chance of any "
    "false verdict is at most 5 % for either word where equal methods have equal distributions; "
    "where one varies ten times as much as another, a test errs up to five times as often as its "
    f"level says. With fewer than {LEAST_SEEDS} seeds of a method nothing is decided.",
    f"Detectable: the difference of means that one comparison shows in {100 * POWER:.0f} % of "
    "studies at the strictest level of the correction, if the values are normal and vary as here; "
    "a dash where the worse method leaves no room for it.",
)
WAITING_NOTE: Final = f"{WAITING.capitalize()}: not every training of the claim has a value yet."


@dataclass(frozen=True)
class Claim:
    """That ``better`` has better values of a metric than each of ``worse``, in each of ``tasks``.

    Raises:
        UsageError: it compares nothing, or the metric has no better direction in a task.
    """

    metric: str
    tasks: tuple[str, ...]
    better: str
    worse: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.metric not in METRICS:
            raise UsageError(f"no metric '{self.metric}'; there are {', '.join(METRICS)}")
        if not (self.tasks and self.worse):
            raise UsageError("a claim names at least one of 'tasks' and one of 'worse'")
        if any(len({*names}) < len(names) for names in (self.tasks, self.methods)):
            raise UsageError("a claim names a task or a method twice")
        metric = METRICS[self.metric]
        for task in self.tasks:
            if not metric.is_in(task) or metric.direction_in(task) == NO_DIRECTION:
                raise UsageError(f"'{self.metric}' has no better direction in '{task}'")

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods that it compares, the better one first."""
        return self.better, *self.worse

    @property
    def trained(self) -> frozenset[tuple[str, str]]:
        """The tasks and methods of the trainings that it is about."""
        return frozenset(product(self.tasks, self.methods))


@dataclass(frozen=True)
class ClaimComparison:
    """Two methods in one task: the values of their training seeds, and the tests of both orders."""

    task: str
    worse: str
    better_values: tuple[float, ...]
    worse_values: tuple[float, ...]
    p: float
    p_reversed: float

    @property
    def means(self) -> tuple[float, float]:
        """The mean of the better and of the worse method; NaN without values."""
        first, second = (
            sum(values) / len(values) if values else float("nan")
            for values in (self.better_values, self.worse_values)
        )
        return first, second

    def detectable(self, level: float) -> float:
        """Return the detectable difference at a significance level.

        NaN if none is, with fewer than LEAST_SEEDS seeds, or without a spread. Seeds vary
        normally, by the pooled standard deviation of these.
        """
        samples = [np.array(self.better_values), np.array(self.worse_values)]
        sizes = [len(sample) for sample in samples]
        freedom = sum(sizes) - 2
        if min(sizes) < LEAST_SEEDS:
            return float("nan")
        squares = sum(float(np.square(sample - sample.mean()).sum()) for sample in samples)
        spread = (squares / freedom) ** 0.5
        return spread * detectable_shift(*sizes, level) if spread else float("nan")


@dataclass(frozen=True)
class JudgedClaim:
    """A claim with its comparisons, its two p-values after correction, and the verdict.

    ``detectable``: the largest of its comparisons', at the level that the correction leaves to the
    smallest p-value; NaN where a share cannot be so much better.
    """

    claim: Claim
    comparisons: tuple[ClaimComparison, ...]
    p_adjusted: float
    p_reversed_adjusted: float
    detectable: float
    is_waiting: bool

    @property
    def verdict(self) -> Literal["confirmed", "contradicted", "not decided", "waiting"]:
        """What the study says of the claim."""
        if self.is_waiting:
            return WAITING
        if self.p_adjusted <= ALPHA:
            return CONFIRMED
        return CONTRADICTED if self.p_reversed_adjusted <= ALPHA else UNDECIDED


def judge_claims(
    claims: Sequence[Claim], values: pd.DataFrame, waiting: Sequence[Claim] = ()
) -> list[JudgedClaim]:
    """Judge claims as one family of tests.

    Args:
        claims: Those of the study's file.
        values: A row per training and metric: task, method, seed, metric, value.
        waiting: Claims without all their values. Until then they have p = 1, which can only make
            the p-values of the others larger.

    Raises:
        ValueError: a training has two values of a metric.
    """
    if values.duplicated(["task", "method", "seed", "metric"]).any():
        raise ValueError("a training has two values of a metric")
    nothing = values.iloc[:0]
    compared = [_compare(claim, nothing if claim in waiting else values) for claim in claims]
    p_values = [max(one.p for one in group) for group in compared]
    reverses = [max(one.p_reversed for one in group) for group in compared]
    return [
        JudgedClaim(claim, group, p, p_reversed, _detectable(claim, group, len(claims)), is_waiting)
        for claim, group, p, p_reversed, is_waiting in zip(
            claims, compared, holm(p_values), holm(reverses),
            [claim in waiting for claim in claims], strict=True,
        )
    ]  # fmt: skip


def _detectable(claim: Claim, compared: Sequence[ClaimComparison], family: int) -> float:
    """Return the largest detectable difference; NaN where one is beyond what a share can reach."""
    differences = []
    for one in compared:
        difference = one.detectable(ALPHA / family)
        if METRICS[claim.metric].is_share and one.means[1] + difference > 1.0:
            return float("nan")
        differences.append(difference)
    return float(np.max(differences))


def _compare(claim: Claim, values: pd.DataFrame) -> tuple[ClaimComparison, ...]:
    compared = []
    for task, worse in product(claim.tasks, claim.worse):
        known = select(values, task=task, metric=claim.metric)
        first, second = (
            tuple(select(known, method=method)["value"].tolist())
            for method in (claim.better, worse)
        )
        sides = ("greater", "less")
        if METRICS[claim.metric].direction_in(task) == DOWN:
            sides = ("less", "greater")
        p, p_reversed = (_rank_test(first, second, side) for side in sides)
        compared.append(ClaimComparison(task, worse, first, second, p, p_reversed))
    return tuple(compared)


def _rank_test(first: Sequence[float], second: Sequence[float], side: str) -> float:
    """Return the p-value, 1 where a method has fewer than LEAST_SEEDS seeds.

    scipy's table of exact p-values does not support ties.
    """
    if min(len(first), len(second)) < LEAST_SEEDS:
        return 1.0
    every_order = scipy.stats.PermutationMethod(ORDERS_TRIED, rng=np.random.default_rng(0))
    test = scipy.stats.mannwhitneyu(first, second, alternative=side, method=every_order)
    return float(test.pvalue)


@cache
def detectable_shift(first: int, second: int, level: float) -> float:
    """Return by how many standard deviations two methods must differ; NaN if none is enough.

    Args:
        first: Training seeds of one method.
        second: Training seeds of the other.
        level: Significance level of the one-sided exact Mann-Whitney test.
    """
    rng = np.random.default_rng(0)
    better, worse = (rng.standard_normal((SIMULATED, size)) for size in (first, second))

    def excess(shift: float) -> float:
        tests = scipy.stats.mannwhitneyu(
            better + shift, worse, alternative="greater", method="exact", axis=1
        )
        return float(np.mean(tests.pvalue <= level)) - POWER

    if excess(LARGEST_SHIFT) < 0.0:
        return float("nan")
    return float(scipy.optimize.bisect(excess, 0.0, LARGEST_SHIFT, xtol=1e-3))


def claims_frame(judged: Sequence[JudgedClaim]) -> pd.DataFrame:
    """Return a row per claim and comparison, for ``claims.csv``."""
    columns = (
        "claim", "metric", "task", "better", "worse", "better_value", "worse_value",
        "better_seeds", "worse_seeds", "p_of_comparison", "p_adjusted", "p_reversed_adjusted",
        "detectable", "verdict",
    )  # fmt: skip
    rows = [
        (
            number, one.claim.metric, pair.task, one.claim.better, pair.worse,
            *pair.means, len(pair.better_values), len(pair.worse_values), pair.p,
            one.p_adjusted, one.p_reversed_adjusted, one.detectable, one.verdict,
        )
        for number, one in enumerate(judged, 1)
        for pair in one.comparisons
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=columns)


def claims_table(judged: Sequence[JudgedClaim]) -> Table:
    """Return a row per claim: the values, those of the paper, and the verdict."""
    rows = []
    for one in judged:
        claim = one.claim
        p = one.p_reversed_adjusted if one.verdict == CONTRADICTED else one.p_adjusted
        tasks = ", ".join(map(task_title, claim.tasks))
        detectable = (
            None if np.isnan(one.detectable) else format_value(claim.metric, one.detectable)
        )
        tested = (detectable, f"{p:.3f}" if p >= 0.001 else "< 0.001")
        rows.append(
            make_row(
                (tasks, METRICS[claim.metric].label),
                f"{claim.better} > {', '.join(claim.worse)}",
                None if one.is_waiting else _means(one),
                "; ".join(_papers(claim, task) for task in claim.tasks),
                *((None, None) if one.is_waiting else tested),
                one.verdict,
            )
        )
    words = ("Claim", "Means over seeds", "The paper", "Verdict")
    columns = make_columns(*words[:3], "Detectable", "p", words[3], words=words)
    notes = (*NOTES, *((WAITING_NOTE,) * any(one.is_waiting for one in judged)))
    return Table("Claims", ("Task", "Metric"), columns, tuple(rows), notes)


def _means(judged: JudgedClaim) -> str:
    """Write each task's means in the order of the claim's methods."""
    parts = []
    for task in judged.claim.tasks:
        pairs = [pair.means for pair in judged.comparisons if pair.task == task]
        means = (pairs[0][0], *(worse for _, worse in pairs))
        parts.append(", ".join(format_value(judged.claim.metric, mean) for mean in means))
    return "; ".join(parts)


def _papers(claim: Claim, task: str) -> str:
    """Write what the paper printed of the claim's methods, a dash where it printed nothing."""
    names = [IN_PAPER.get(method) for method in claim.methods]
    values = [name and paper_value(task, claim.metric, name) for name in names]
    texts = [value.text if value and value.is_our_unit else ABSENT for value in values]
    return ABSENT if {*texts} == {ABSENT} else ", ".join(texts)
