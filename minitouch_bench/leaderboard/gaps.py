"""What a submission loses on shapes never trained on: held-out minus train."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.leaderboard.entries import Entry, Episodes
from minitouch_bench.leaderboard.ranking import RANKED_BY
from minitouch_bench.leaderboard.scores import OVER_SEEDS, ROOT
from minitouch_bench.metrics import (
    METRICS,
    bootstrap_difference,
    bootstrap_mean,
    newcombe,
    wilson,
)
from minitouch_bench.metrics.intervals import stream
from minitouch_bench.metrics.metric import Kind
from minitouch_bench.metrics.shared_bootstrap import resample_weights, stratified_intervals
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import Estimate, Gap, Role

NOVEL_SHAPES = "novel-shapes"
GAP_TASKS = PROTOCOL.suite(NOVEL_SHAPES).tasks

Floats = NDArray[np.float64]


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
        return _over_seeds(listed, task)
    held_out, train = _splits(listed[0], task)
    if METRICS[RANKED_BY[task]].kind is Kind.SHARE:
        one, other = (wilson(int(values.sum()), values.size) for values in (held_out, train))
        return Gap(one, other, newcombe(one, other))
    return _over_episodes(held_out, train, task)


def _splits(episodes: Episodes, task: str) -> tuple[Floats, Floats]:
    """Return the metric's values on held-out and on train shapes."""
    values = episodes.values[RANKED_BY[task]]
    return values[episodes.held_out], values[~episodes.held_out]


def _over_episodes(held_out: Floats, train: Floats, task: str) -> Gap:
    one, other = (
        bootstrap_mean(values, stream(ROOT, "gap", task, split))
        for split, values in (("held-out", held_out), ("train", train))
    )
    return Gap(one, other, bootstrap_difference(held_out, train, stream(ROOT, "gap", task)))


def _over_seeds(listed: Sequence[Episodes], task: str) -> Gap:
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
