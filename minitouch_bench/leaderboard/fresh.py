"""Fresh episodes: seeds that nobody knew when a checkpoint was fixed, and the test for a drop.

The official seeds are public, so a table of stored actions can succeed in all of their episodes.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from minitouch_bench.episode import Role
from minitouch_bench.leaderboard.ranking import RunsBySuite
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import Floats, mean_difference
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.runs.plan import NOVEL_SUITES, Plan, make_plan
from minitouch_bench.runs.run import Run

FRESH_EPISODES = 50
"""Per task and training. On novel shapes half of them have held-out shapes."""

SIGNIFICANCE = 0.01
"""Upper limit of the chance that an honest row loses its rank."""

ORDERS = 200_000
"""Number of random orders of the episodes in a permutation test."""


def fresh_plan(suite: str, checkpoint: str, draw: str) -> Plan:
    """Return the fresh episodes of a suite; their seed is SHA-256 over checkpoint and draw.

    On novel shapes the seed draws which shapes they have, too: a fixed part of them could be easier
    or harder than the whole.
    """
    seed = int.from_bytes(hashlib.sha256(f"{checkpoint} {draw}".encode()).digest(), "big")
    plan = make_plan(suite)
    if suite not in NOVEL_SUITES:
        return replace(plan, episodes=FRESH_EPISODES, seed=seed)
    rng = np.random.default_rng(seed)
    chosen = []
    for task in plan.tasks:  # an even episode has a held-out shape, the next one a train shape
        pairs = rng.choice(plan.episodes // 2, FRESH_EPISODES // 2, replace=False)
        chosen += [f"{task}/{2 * pair + turn}" for pair in sorted(pairs) for turn in range(2)]
    return replace(plan, seed=seed, chosen=tuple(chosen))


def drop_p(official: RunsBySuite, fresh: RunsBySuite) -> float:
    """Return the p-value of a drop from a policy's official episodes to its fresh ones.

    One joint one-sided test over the suites and tasks, each with its p-value over the trainings
    together. Fisher's method combines them, which finds a small drop in many tasks; the smallest
    one times their number (Bonferroni) finds a drop in a single task beside tasks that cannot drop.
    The smaller of the two results counts, times two, and so does that of the final and of the
    exploration policy, which play the same scenes and are not independent.

    Source: R. A. Fisher, "Statistical Methods for Research Workers" (1932), combined p-values.
    """
    combined = []
    for role in Role:
        p_values = [
            _task_p(_values(runs, role, task), _values(fresh[suite], role, task))
            for suite, runs in official.items()
            for task in runs[0].tasks
            if role is Role.FINAL or (task in GOAL_TASKS and runs[0].exploration_rows)
        ]
        if p_values:
            joint = float(scipy.stats.combine_pvalues(p_values, method="fisher").pvalue)
            combined.append(2 * min(joint, len(p_values) * min(p_values)))
    return min(1.0, len(combined) * min(combined))


def _values(runs: Sequence[Run], role: Role, task: str) -> Floats:
    """Return the mean over trainings of what ranks a task, by episode number, float64 (E,).

    All trainings play the same official scenes, and each its own fresh ones.
    """
    metric = METRICS[ranking_metric(task)]
    rows = [[row for row in dict(run.by_role())[role] if row.task == task] for run in runs]
    return np.mean([metric.values(of_one) for of_one in rows], axis=0)


def _task_p(official: Floats, fresh: Floats) -> float:
    """Return the p-value of a drop of the mean: Fisher's exact test of shares, else permutation."""
    if {*official, *fresh} <= {0.0, 1.0}:
        table = [[values.sum(), len(values) - values.sum()] for values in (official, fresh)]
        return float(scipy.stats.fisher_exact(table, alternative="greater").pvalue)
    test = scipy.stats.permutation_test(
        (official, fresh), mean_difference, n_resamples=ORDERS, batch=2_000, vectorized=True,
        alternative="greater", rng=np.random.default_rng(0),
    )  # fmt: skip
    return float(test.pvalue)
