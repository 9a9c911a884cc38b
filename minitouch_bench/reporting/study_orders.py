"""Whether a study shows the paper's order of methods, cell by cell of its Table 4."""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np
import pandas as pd
import scipy
from numpy.typing import NDArray

from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.metric import DOWN
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.rendering.tables import Cell, Table, format_value, make_columns, make_row
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.long_frame import select
from minitouch_bench.reporting.study_figures import study_parts
from minitouch_bench.runs.run import Run

PAIRS: Final = (
    ("hac", "rnd-touch"),
    ("rnd-touch", "rnd"),
    ("hac", "rnd"),
    *(("hac", other) for other in ("icm", "icm-touch", "disagreement", "sac")),
)
"""The better and the worse method; the first three are in the order of the paper's Table 4."""

SIGNIFICANT = 0.05
SMALLEST_P = 0.001
MOST_ORDERS = 100_000
"""Over seeds: every assignment of the values to two methods is tried, or this many draws of it."""
EPISODE_ORDERS = 9_999
"""Over episodes: so many random exchanges of the two methods' values."""

NOTES = (
    "Over seeds: Mann and Whitney's exact test, which tells what another training would show; "
    "three seeds each can just reach p = 0.050. On the same episodes: permutation test of paired "
    "episodes, each one's mean over the seeds, which tells of these trainings alone. One-sided, "
    "not corrected for their number; > is: better than.",
    "The paper's Table 4 orders hac, rnd-touch and rnd; the other pairs are our questions.",
)


def episode_values(run: Run) -> Iterator[tuple[str, int, float]]:
    """Yield metric, index of the episode and value, for what orders the methods in a run."""
    for role, episodes in run.by_role():
        for episode in episodes:
            for name in _ordered_metrics(episode.task):
                value = METRICS[name].value(episode)
                if METRICS[name].role is role and value is not None:
                    yield name, episode.index, float(value)


def _ordered_metrics(task: str) -> tuple[str, ...]:
    """Return the rows of Table 4 that have a direction and a unit the paper shares."""
    if task in GOAL_TASKS:
        return "exploration", "success", "episode_steps"
    return (ranking_metric(task),)


def judge_orders(values: pd.DataFrame) -> pd.DataFrame:
    """Return a row per task, length of exploration, metric and pair that the study has.

    ``values`` has a row per training, metric and episode: task, method, seed, steps (of
    exploration), metric, episode, value. A p-value is nan of one seed, or one episode;
    ``p_*_reversed`` is that of the opposite order.
    """
    rows = []
    for task, steps, part in study_parts(values):
        for metric, pair in product(_ordered_metrics(task), PAIRS):
            selected = (select(part, metric=metric, method=method) for method in pair)
            tables = [values.pivot_table("value", "episode", "seed") for values in selected]
            if any(table.empty for table in tables):
                continue
            sign = -1.0 if METRICS[metric].direction_in(task) == DOWN else 1.0
            better, worse = (sign * table for table in tables)
            rows.append(
                (
                    task, steps, metric, *pair,
                    *(float(table.mean(axis=1).mean()) for table in tables),
                    *(table.shape[1] for table in tables),
                    *_p_over_seeds(better.mean().tolist(), worse.mean().tolist()),
                    *_p_on_episodes(better.mean(axis=1), worse.mean(axis=1)),
                )
            )  # fmt: skip
    columns = (
        "task", "exploration_steps", "metric", "better", "worse", "better_value", "worse_value",
        "better_seeds", "worse_seeds", "p_seeds", "p_seeds_reversed", "p_episodes",
        "p_episodes_reversed",
    )  # fmt: skip
    return pd.DataFrame(rows, columns=columns)


def _p_over_seeds(better: Sequence[float], worse: Sequence[float]) -> tuple[float, float]:
    if min(len(better), len(worse)) < 2:
        return float("nan"), float("nan")
    every_order = scipy.stats.PermutationMethod(MOST_ORDERS, rng=np.random.default_rng(0))
    greater, less = (
        scipy.stats.mannwhitneyu(better, worse, alternative=side, method=every_order).pvalue
        for side in ("greater", "less")
    )
    return float(greater), float(less)


def _p_on_episodes(better: pd.Series, worse: pd.Series) -> tuple[float, float]:
    first, second = better.align(worse, join="inner")
    if len(first) < 2:
        return float("nan"), float("nan")
    if first.equals(second):
        return 1.0, 1.0
    greater, less = (
        scipy.stats.permutation_test(
            (first.to_numpy(), second.to_numpy()), _mean_difference, permutation_type="samples",
            vectorized=True, alternative=side, n_resamples=EPISODE_ORDERS,
            rng=np.random.default_rng(0),
        ).pvalue
        for side in ("greater", "less")
    )  # fmt: skip
    return float(greater), float(less)


def _mean_difference(
    first: NDArray[np.float64], second: NDArray[np.float64], axis: int
) -> NDArray[np.float64]:
    mean: NDArray[np.float64] = np.mean(first - second, axis=axis)
    return mean


def orders_table(orders: pd.DataFrame) -> Table:
    """Return what ``judge_orders`` found as a table."""
    rows = []
    for order in orders.to_dict("records"):
        metric = order["metric"]
        task = f"{task_title(order['task'])}, {order['exploration_steps']:,} steps"
        values = (
            f"{format_value(metric, order[f'{side}_value'])} ({order[f'{side}_seeds']})"
            for side in ("better", "worse")
        )
        verdicts = (_verdict(order, over) for over in ("seeds", "episodes"))
        pair = f"{order['better']} > {order['worse']}"
        rows.append(make_row((task, METRICS[metric].label), pair, *values, *verdicts))
    words = ("Order", "Over training seeds", "On the same episodes")
    columns = make_columns("Order", "First (seeds)", "Second (seeds)", *words[1:], words=words)
    title = "The order of the methods"
    return Table(title, ("Task, exploration", "Metric"), columns, tuple(rows), NOTES)


def _verdict(order: Mapping[Hashable, Any], over: str) -> Cell:
    p, p_reversed = order[f"p_{over}"], order[f"p_{over}_reversed"]
    if np.isnan(p):
        return Cell("not tested", f"(too few {over})")
    if p <= SIGNIFICANT:
        return Cell("holds", f"({_p_text(p)})")
    if p_reversed <= SIGNIFICANT:
        return Cell("does not hold", f"(the opposite: {_p_text(p_reversed)})")
    return Cell("not significant", f"({_p_text(p)})")


def _p_text(p: float) -> str:
    return f"p = {p:.3f}" if p >= SMALLEST_P else f"p < {SMALLEST_P}"
