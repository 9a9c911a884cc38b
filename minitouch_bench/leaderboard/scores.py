"""The figures of a board: every one computed here from the episodes, with its interval.

All rows share one set of resamples, so equal episodes give equal intervals.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.leaderboard.entries import BOARD_METRICS, Entry, Episodes
from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import (
    BOOTSTRAP,
    bootstrap_difference,
    bootstrap_mean,
    mean_intervals,
    newcombe,
    resample_weights,
    stratified_intervals,
    stream,
    wilson,
)
from minitouch_bench.metrics.metric import Kind
from minitouch_bench.protocol.minitouch import MAIN_SUITE, NOVEL_SHAPES, PROTOCOL
from minitouch_bench.records import Estimate, Gap, Role

ROOT = (0,)
"""Root of the board's random streams: the same submissions give the same board."""

OVERALL = "overall"
MEAN_SUCCESS = "mean_success"
"""The board's own metric: the mean of the success rates of the tasks with a goal."""

RANKED_BY: Mapping[str, str] = {
    OVERALL: MEAN_SUCCESS,
    **{task: ranking_metric(task) for task in BOARD_TASKS},
}
"""What ranks the rows overall and in each task."""

GAP_TASKS = PROTOCOL.suite(NOVEL_SHAPES).tasks
"""The tasks that are compared on held-out and on train shapes."""

OVER_SEEDS = "bootstrap over training seeds"
SHARE_OVER_SEEDS = "bootstrap over training seeds, no narrower than Wilson over all episodes"
OVER_TASKS = "Wilson intervals of the tasks, added in quadrature"

Floats = NDArray[np.float64]
Figures = dict[str, dict[str, Estimate]]
"""A submission's estimates by task or OVERALL, then by metric."""


def score(entry: Entry) -> Figures:
    """Estimate every figure of the main suite."""
    estimate = _over_episodes if len(entry.seeds) == 1 else _over_seeds
    figures: Figures = {key: {} for key in (OVERALL, *BOARD_TASKS)}
    for task in BOARD_TASKS:
        columns = {
            name: entry.values(MAIN_SUITE, METRICS[name].role, task, name)
            for name in BOARD_METRICS
            if METRICS[name].is_in(task) and entry.all_have(MAIN_SUITE, METRICS[name].role, task)
        }
        figures[task] = estimate(columns, task)
    shares = [figures[task].get("success") for task in BOARD_GOALS]
    known = [share for share in shares if share is not None]
    if len(known) == len(BOARD_GOALS):
        is_single = len(entry.seeds) == 1
        figures[OVERALL][MEAN_SUCCESS] = _quadrature(known) if is_single else _stratified(entry)
    return figures


def _over_episodes(columns: Mapping[str, Sequence[Floats]], task: str) -> dict[str, Estimate]:
    """Estimate over the episodes of one seed: Wilson for a share, bootstrap for a mean."""
    single = {name: values for name, (values,) in columns.items()}
    means = {name: own for name, own in single.items() if METRICS[name].kind is not Kind.SHARE}
    table = np.array(list(means.values()))
    weights = resample_weights(table.shape[1], ROOT, task)
    limits = dict(zip(means, mean_intervals(table, weights), strict=True))
    found = {}
    for name, values in single.items():
        if name not in means:
            found[name] = _share(values)
        elif (known := values[~np.isnan(values)]).size:
            mean, (low, high) = float(known.mean()), map(float, limits[name])
            # One value alone, or equal ones, vary by rounding only.
            found[name] = Estimate(mean, min(low, mean), max(high, mean), known.size, BOOTSTRAP)
    return found


def _over_seeds(columns: Mapping[str, Sequence[Floats]], task: str) -> dict[str, Estimate]:
    """Estimate over training seeds; none where a seed has no value."""
    found = {}
    for name, samples in columns.items():
        means = _seed_means(samples)
        if not np.isnan(means).any():
            over_seeds = _of_seeds(means, f"{task}/{name}")
            is_share = METRICS[name].kind is Kind.SHARE
            found[name] = _widened(over_seeds, _share(*samples)) if is_share else over_seeds
    return found


def _seed_means(samples: Sequence[Floats]) -> Floats:
    """Return the mean of each training seed's values, (S,); NaN where no episode has one."""
    kept = [values[~np.isnan(values)] for values in samples]
    return np.array([values.mean() if values.size else math.nan for values in kept])


def _of_seeds(means: Floats, name: str) -> Estimate:
    """Estimate the mean over training seeds of their means."""
    weights = resample_weights(means.size, ROOT, f"seeds/{name}")
    ((low, high),) = stratified_intervals([means[None]], [weights])
    return Estimate(float(means.mean()), float(low), float(high), means.size, OVER_SEEDS)


def _share(*samples: Floats) -> Estimate:
    """Estimate a share over the episodes of all samples together."""
    values = np.concatenate(samples)
    return wilson(int(values.sum()), values.size)


def _widened(found: Estimate, pooled: Estimate) -> Estimate:
    """Keep an interval over a few equal seeds from having no width."""
    low, high = min(found.low, pooled.low), max(found.high, pooled.high)
    return Estimate(found.value, low, high, found.count, SHARE_OVER_SEEDS)


def _quadrature(parts: Sequence[Estimate]) -> Estimate:
    """Join independent shares into their mean; the interval keeps a width at 0 and at 100 %.

    Source: G. Y. Zou and A. Donner, "Construction of confidence limits about effect measures:
    a general approach", Stat. Med. 27 (2008), with Wilson's limits of each share.
    """
    number = len(parts)
    value = sum(part.value for part in parts) / number
    below = math.sqrt(sum((part.value - part.low) ** 2 for part in parts)) / number
    above = math.sqrt(sum((part.high - part.value) ** 2 for part in parts)) / number
    count = sum(part.count for part in parts)
    return Estimate(value, value - below, value + above, count, OVER_TASKS)


def _stratified(entry: Entry) -> Estimate:
    """Estimate the mean success over training seeds, resampled task by task."""
    samples = {task: entry.values(MAIN_SUITE, Role.FINAL, task, "success") for task in BOARD_GOALS}
    size = len(entry.seeds)
    weights = [resample_weights(size, ROOT, f"seeds/{task}/success") for task in samples]
    strata = [_seed_means(own)[None] for own in samples.values()]
    ((low, high),) = stratified_intervals(strata, weights)
    pooled = _quadrature([_share(*own) for own in samples.values()])
    found = Estimate(pooled.value, float(low), float(high), size, OVER_SEEDS)
    return _widened(found, pooled)


def score_gaps(entry: Entry) -> dict[str, Gap]:
    """Return the gap of each task's own metric; empty without the suite."""
    return {
        task: _gap(entry.episodes(NOVEL_SHAPES, Role.FINAL, task), task)
        for task in GAP_TASKS
        if entry.all_have(NOVEL_SHAPES, Role.FINAL, task)
    }


def _gap(listed: Sequence[Episodes], task: str) -> Gap:
    """Compare the held-out and the train shapes: over episodes, or over several seeds.

    Two seeds agree in the sign of a gap as often as not, so theirs is no narrower than that over
    all their episodes.
    """
    metric = METRICS[RANKED_BY[task]]
    held_out = [one.values[metric.name][one.held_out] for one in listed]
    train = [one.values[metric.name][~one.held_out] for one in listed]
    if metric.kind is Kind.SHARE:
        one, other = _share(*held_out), _share(*train)
        over_episodes = one, other, newcombe(one, other)
    else:
        of_held_out, of_train = np.concatenate(held_out), np.concatenate(train)
        over_episodes = (
            bootstrap_mean(of_held_out, stream(ROOT, "gap", task, "held-out")),
            bootstrap_mean(of_train, stream(ROOT, "gap", task, "train")),
            bootstrap_difference(of_held_out, of_train, stream(ROOT, "gap", task)),
        )
    if len(listed) == 1:
        return Gap(*over_episodes)
    first, second = (np.array([own.mean() for own in split]) for split in (held_out, train))
    means = first, second, first - second
    return Gap(
        *(
            _widened(_of_seeds(own, f"{task}/gap"), pooled)
            for own, pooled in zip(means, over_episodes, strict=True)
        )
    )
