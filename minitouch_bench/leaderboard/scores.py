"""The figures of a board: every one computed here from the episodes, with its interval.

All rows share one set of resamples, so equal episodes give equal intervals.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.leaderboard.entries import BOARD_METRICS, Ending, Entry, Episodes
from minitouch_bench.leaderboard.proof import FreshProof, ProofLevel
from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS, MAIN_SUITE, Submission
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
from minitouch_bench.metrics.metric import Kind, Metric
from minitouch_bench.policies.formats import BUILT_IN
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import Estimate, Gap, Role

ROOT = (0,)
"""Root of the board's random streams: the same submissions give the same board."""

OVERALL = "overall"
MEAN_SUCCESS = "mean_success"
"""The board's own metric: the mean of the success rates of the tasks with a goal."""

RANKED_BY: Mapping[str, str] = {task: ranking_metric(task) for task in BOARD_TASKS}
"""What a task is ranked by; overall it is the mean success over the tasks with a goal."""

NOVEL_SHAPES = "novel-shapes"
GAP_TASKS = PROTOCOL.suite(NOVEL_SHAPES).tasks
"""The tasks that are compared on held-out and on train shapes."""

OVER_SEEDS = "bootstrap over training seeds"
SHARE_OVER_SEEDS = "bootstrap over training seeds, no narrower than Wilson over all episodes"
OVER_TASKS = "Wilson intervals of the tasks, added in quadrature"

Floats = NDArray[np.float64]
Figures = dict[str, dict[str, Estimate]]
"""A submission's estimates by task or OVERALL, then by metric."""


@dataclass(frozen=True)
class ScoredSubmission:
    """All that a board shows of one submission and that no other one changes, as plain JSON.

    ``runs``: the digest of each run by its path. ``figures`` by task or "overall", then by
    metric; ``gaps`` by task; ``endings``: number of episodes by task and ending. ``values`` by
    task: of each training seed, the episodes' values in the metric that ranks the task.
    ``videos`` are paths in the submission. ``page`` is its page, with marks where the ranks
    stand. ``sketches``: see ``twins.sketch_of``; only a proof has them.
    """

    about: Submission
    level: ProofLevel
    rerun_episodes: int
    fresh: FreshProof | None
    sketches: Mapping[str, tuple[float, ...]]
    runs: Mapping[str, str]
    figures: Mapping[str, Mapping[str, Estimate]]
    gaps: Mapping[str, Gap]
    endings: Mapping[str, Mapping[Ending, int]]
    values: Mapping[str, tuple[tuple[float, ...], ...]]
    videos: tuple[str, ...]
    page: str = ""

    @property
    def name(self) -> str:
        """The submission's name."""
        return self.about.name

    @property
    def is_calibration(self) -> bool:
        """Whether it is one of the built-in policies, which are shown and never ranked."""
        return self.name in BUILT_IN

    def estimate(self, task: str, metric: str) -> Estimate | None:
        """Return an estimate, None where there is none."""
        return self.figures.get(task, {}).get(metric)


@dataclass(frozen=True)
class Refusal:
    """A submission that is not on the board, with every reason."""

    name: str
    reasons: tuple[str, ...]
    is_other_protocol: bool


def score(entries: Sequence[Entry]) -> list[Figures]:
    """Estimate every figure of the main suite, one mapping per entry in their order."""
    figures: list[Figures] = [{key: {} for key in (OVERALL, *BOARD_TASKS)} for _ in entries]
    for task in BOARD_TASKS:
        for name in BOARD_METRICS:
            if METRICS[name].is_in(task):
                _score(entries, figures, task, METRICS[name])
    _score_overall(entries, figures)
    return figures


def seed_means(entry: Entry, task: str, metric: Metric) -> Floats:
    """Return a metric's mean of each training seed, (S,); NaN where no episode has a value."""
    found = []
    for episodes in entry.episodes(MAIN_SUITE, metric.role, task):
        values = episodes.values[metric.name]
        kept = values[~np.isnan(values)]
        found.append(float(kept.mean()) if kept.size else math.nan)
    return np.array(found)


def _score(entries: Sequence[Entry], figures: list[Figures], task: str, metric: Metric) -> None:
    """Estimate one metric of one task for all entries that have it."""
    name, role = metric.name, metric.role
    present = [i for i, entry in enumerate(entries) if entry.all_have(MAIN_SUITE, role, task)]
    single = [i for i in present if len(entries[i].seeds) == 1]
    rows = [entries[i].episodes(MAIN_SUITE, role, task)[0].values[name] for i in single]
    for i, found in zip(single, _over_episodes(rows, task, metric), strict=True):
        if found is not None:
            figures[i][task][name] = found
    means = {i: seed_means(entries[i], task, metric) for i in present if len(entries[i].seeds) > 1}
    known = {i: found for i, found in means.items() if not np.isnan(found).any()}
    for i, over_seeds in _over_seeds(known, f"{task}/{name}").items():
        figures[i][task][name] = (
            _widened(over_seeds, _pooled(entries[i], task, metric))
            if metric.kind is Kind.SHARE
            else over_seeds
        )


def _over_episodes(rows: Sequence[Floats], task: str, metric: Metric) -> list[Estimate | None]:
    """Estimate over the episodes of one seed: Wilson for a share, bootstrap for a mean."""
    if metric.kind is Kind.SHARE:
        return [wilson(int(values.sum()), values.size) for values in rows]
    found: list[Estimate | None] = [None] * len(rows)
    for size in sorted({values.size for values in rows}):
        own = [i for i, values in enumerate(rows) if values.size == size]
        table = np.array([rows[i] for i in own])
        there = ~np.isnan(table)
        weights = resample_weights(size, ROOT, task)
        filled = np.where(there, table, 0.0)
        limits = mean_intervals(filled, weights, None if there.all() else there)
        for i, values, marked, (low, high) in zip(own, table, there, limits, strict=True):
            if marked.any():
                mean = float(values[marked].mean())
                # One value alone, or equal ones, vary by rounding only.
                low, high = min(low, mean), max(high, mean)  # noqa: PLW2901
                count = int(marked.sum())
                found[i] = Estimate(mean, float(low), float(high), count, BOOTSTRAP)
    return found


def _over_seeds(means: Mapping[int, Floats], name: str) -> dict[int, Estimate]:
    """Estimate over training seeds, for rows of every number of them."""
    found: dict[int, Estimate] = {}
    for size in sorted({values.size for values in means.values()}):
        own = [i for i, values in means.items() if values.size == size]
        table = np.array([means[i] for i in own])
        weights = resample_weights(size, ROOT, f"seeds/{name}")
        limits = stratified_intervals([table], [weights])
        for i, values, (low, high) in zip(own, table, limits, strict=True):
            found[i] = Estimate(float(values.mean()), float(low), float(high), size, OVER_SEEDS)
    return found


def _pooled(entry: Entry, task: str, metric: Metric) -> Estimate:
    """Estimate a share over the episodes of all training seeds together."""
    listed = entry.episodes(MAIN_SUITE, metric.role, task)
    values = np.concatenate([episodes.values[metric.name] for episodes in listed])
    return wilson(int(values.sum()), values.size)


def _widened(found: Estimate, pooled: Estimate) -> Estimate:
    """Keep an interval over a few equal seeds from having no width."""
    low, high = min(found.low, pooled.low), max(found.high, pooled.high)
    return Estimate(found.value, low, high, found.count, SHARE_OVER_SEEDS)


def _score_overall(entries: Sequence[Entry], figures: list[Figures]) -> None:
    """Estimate the mean success over the tasks with a goal."""
    for entry, own in zip(entries, figures, strict=True):
        parts = [own[task].get("success") for task in BOARD_GOALS]
        known = [part for part in parts if part is not None]
        if len(known) < len(BOARD_GOALS):
            continue
        if len(entry.seeds) == 1:
            own[OVERALL][MEAN_SUCCESS] = _quadrature(known)
        else:
            own[OVERALL][MEAN_SUCCESS] = _stratified(entry)


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
    success = METRICS["success"]
    strata = [seed_means(entry, task, success)[None] for task in BOARD_GOALS]
    size = len(entry.seeds)
    weights = [resample_weights(size, ROOT, f"seeds/{task}/success") for task in BOARD_GOALS]
    low, high = stratified_intervals(strata, weights)[0]
    pooled = _quadrature([_pooled(entry, task, success) for task in BOARD_GOALS])
    found = Estimate(pooled.value, float(low), float(high), size, OVER_SEEDS)
    return _widened(found, pooled)


def score_gaps(entry: Entry) -> dict[str, Gap]:
    """Return the gap of each task's own metric; empty without the suite."""
    return {
        task: _gap(entry, task)
        for task in GAP_TASKS
        if entry.all_have(NOVEL_SHAPES, Role.FINAL, task)
    }


def _gap(entry: Entry, task: str) -> Gap:
    listed = entry.episodes(NOVEL_SHAPES, Role.FINAL, task)
    if len(listed) > 1:
        return _gap_over_seeds(listed, task)
    held_out, train = _splits(listed[0], task)
    if METRICS[RANKED_BY[task]].kind is Kind.SHARE:
        one, other = (wilson(int(values.sum()), values.size) for values in (held_out, train))
        return Gap(one, other, newcombe(one, other))
    return _gap_over_episodes(held_out, train, task)


def _splits(episodes: Episodes, task: str) -> tuple[Floats, Floats]:
    """Return the metric's values on held-out and on train shapes."""
    values = episodes.values[RANKED_BY[task]]
    return values[episodes.held_out], values[~episodes.held_out]


def _gap_over_episodes(held_out: Floats, train: Floats, task: str) -> Gap:
    one, other = (
        bootstrap_mean(values, stream(ROOT, "gap", task, split))
        for split, values in (("held-out", held_out), ("train", train))
    )
    return Gap(one, other, bootstrap_difference(held_out, train, stream(ROOT, "gap", task)))


def _gap_over_seeds(listed: Sequence[Episodes], task: str) -> Gap:
    """Estimate each split and the gap over training seeds."""
    means = np.array([[values.mean() for values in _splits(one, task)] for one in listed])
    rows = np.array([means[:, 0], means[:, 1], means[:, 0] - means[:, 1]])
    weights = resample_weights(len(listed), ROOT, f"seeds/{task}/gap")
    limits = stratified_intervals([rows], [weights])
    held_out, train, difference = (
        Estimate(float(values.mean()), float(low), float(high), len(listed), OVER_SEEDS)
        for values, (low, high) in zip(rows, limits, strict=True)
    )
    return Gap(held_out, train, difference)
