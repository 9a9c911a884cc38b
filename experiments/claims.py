"""Claims of an experiment: that a method is better than others, judged over training seeds.

The design file declares them before the first training. All of them together are one family of
tests for Holm's correction.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import scipy

from minitouch_bench.metrics.definitions import DOWN, METRICS
from minitouch_bench.metrics.statistics import ALPHA, POWER, holm

LEAST_SEEDS = 5
"""Training seeds per method below which nothing is decided."""

ORDERS_TRIED = 200_000
"""Orders of the values that a test counts: all up to ten seeds per method, then random ones."""

SIMULATED = 2_000
"""Pairs of methods in which a power is counted."""

LARGEST_SHIFT = 50.0
"""Standard deviations; a test that does not detect these has no power at all."""

SHARED_NOTE = (
    "Methods share, seed by seed, the scenes of the training, the first weights and the first "
    "1,000 actions, and all play the same official episodes: the results are about these scenes. "
    "Where this makes the values of a seed alike, the tests err less often than they say."
)

NOTES = (
    "One-sided exact Mann-Whitney tests; the unit is the training seed. They ask whether the "
    "values of one method tend to be larger, which is not a test of the means where methods vary "
    "unequally. A claim with several comparisons has the largest of their p-values. p: adjusted "
    f"by Holm's method over all claims of this table. Confirmed: p ≤ {ALPHA}. Contradicted: the "
    f"reverse of every comparison has p ≤ {ALPHA}, with the same correction. The chance of any "
    "false verdict is at most 5 % for either word where equal methods have equal distributions; "
    "where they have equal means and unequal distributions, as when one method fails in some "
    f"seeds, no bound is known. With fewer than {LEAST_SEEDS} seeds of a method nothing is "
    "decided.",
    f"Detectable: the difference of means that one comparison shows in {100 * POWER:.0f} % of "
    "studies at the strictest level of the correction, if the values are normal and vary as here; "
    "a dash where the worse method leaves no room for it.",
    SHARED_NOTE,
)


def judge_claims(claims: Sequence[Mapping[str, Any]], values: pd.DataFrame) -> pd.DataFrame:
    """Judge claims as one family of tests.

    Args:
        claims: Those of the design: tasks, metric, better, worse.
        values: A row per training and metric: task, method, metric, value.

    Returns:
        A row per claim and comparison; the values of both methods as tuples. A claim without five
        seeds of each method has p = 1.
    """
    compared = pd.DataFrame(
        [
            {"claim": number, **_compare(claim, task, worse, values)}
            for number, claim in enumerate(claims, 1)
            for task, worse in product(claim["tasks"], claim["worse"])
        ]
    )
    if compared.empty:
        return compared
    by_claim = compared.groupby("claim", sort=False)
    adjusted = {
        "p_adjusted": holm(by_claim["p"].max().tolist()),
        "p_reversed_adjusted": holm(by_claim["p_reversed"].max().tolist()),
    }
    for name, p_values in adjusted.items():
        compared[name] = compared["claim"].map(dict(enumerate(p_values, 1)))
    compared["detectable"] = [
        _detectable(*row, level=ALPHA / len(claims))
        for row in compared[["metric", "better_values", "worse_values"]].itertuples(index=False)
    ]
    largest = compared.groupby("claim")["detectable"].agg(lambda found: found.max(skipna=False))
    compared["detectable"] = compared["claim"].map(largest)
    compared["verdict"] = np.select(
        [compared["p_adjusted"] <= ALPHA, compared["p_reversed_adjusted"] <= ALPHA],
        ["confirmed", "contradicted"],
        "not decided",
    )
    return compared


def _compare(
    claim: Mapping[str, Any], task: str, worse: str, values: pd.DataFrame
) -> dict[str, Any]:
    known = values[(values["task"] == task) & (values["metric"] == claim["metric"])]
    first, second = (
        tuple(known.loc[known["method"] == method, "value"]) for method in (claim["better"], worse)
    )
    falls = METRICS[claim["metric"]].direction_in(task) == DOWN
    sides = ("less", "greater") if falls else ("greater", "less")
    p, p_reversed = (_rank_test(first, second, side) for side in sides)
    return {
        "metric": claim["metric"], "task": task, "better": claim["better"], "worse": worse,
        "better_values": first, "worse_values": second, "p": p, "p_reversed": p_reversed,
    }  # fmt: skip


def _rank_test(first: Sequence[float], second: Sequence[float], side: str) -> float:
    """Return the p-value over orders: scipy's table of exact p-values does not support ties."""
    if min(len(first), len(second)) < LEAST_SEEDS:
        return 1.0
    every_order = scipy.stats.PermutationMethod(ORDERS_TRIED, rng=np.random.default_rng(0))
    test = scipy.stats.mannwhitneyu(first, second, alternative=side, method=every_order)
    return float(test.pvalue)


def _detectable(
    metric: str, better: Sequence[float], worse: Sequence[float], level: float
) -> float:
    """Return the detectable difference of means; NaN where there is none below 1 in a share."""
    if min(len(better), len(worse)) < LEAST_SEEDS:
        return float("nan")
    squares = sum(np.square(np.subtract(one, np.mean(one))).sum() for one in (better, worse))
    spread = (squares / (len(better) + len(worse) - 2)) ** 0.5
    shift = detectable_shift(len(better), len(worse), level) if spread else float("nan")
    is_beyond = METRICS[metric].is_fraction and np.mean(worse) + spread * shift > 1.0
    return float("nan") if is_beyond else float(spread * shift)


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
