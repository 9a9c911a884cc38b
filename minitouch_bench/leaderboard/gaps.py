"""What a submission loses on shapes never trained on: held-out minus train."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.leaderboard.entries import Entry, Episodes
from minitouch_bench.leaderboard.ranking import RANKED_BY
from minitouch_bench.leaderboard.scores import MEANS, OVER_SEEDS, ROOT, SHARES
from minitouch_bench.metrics import newcombe, wilson
from minitouch_bench.metrics.intervals import BOOTSTRAP, PERCENTILES
from minitouch_bench.metrics.shared_bootstrap import mean_intervals, resample_weights
from minitouch_bench.records import Estimate, Gap, Role

NOVEL_SHAPES = "novel-shapes"
GAP_TASKS = ("playing", "pushing", "pick-up")

Floats = NDArray[np.float64]


def score_gaps(entries: Sequence[Entry]) -> list[dict[str, Gap]]:
    """Return the gap of each task's own metric, one mapping an entry; empty without the suite."""
    return [
        {
            task: _gap(entry, task)
            for task in GAP_TASKS
            if entry.all_have(NOVEL_SHAPES, Role.FINAL, task)
        }
        for entry in entries
    ]


def _gap(entry: Entry, task: str) -> Gap:
    listed = entry.episodes(NOVEL_SHAPES, Role.FINAL, task)
    if len(listed) > 1:
        return _over_seeds(listed, task)
    held_out, train = _splits(listed[0], task)
    if RANKED_BY[task] in SHARES:
        one, other = (wilson(int(values.sum()), values.size) for values in (held_out, train))
        return Gap(one, other, newcombe(one, other))
    return _over_episodes(held_out, train, task)


def _splits(episodes: Episodes, task: str) -> tuple[Floats, Floats]:
    """Return the metric's values on held-out and on train shapes."""
    metric = RANKED_BY[task]
    values = (SHARES[metric][1] if metric in SHARES else MEANS[metric])(episodes)
    return values[episodes.held_out], values[~episodes.held_out]


def _over_episodes(held_out: Floats, train: Floats, task: str) -> Gap:
    draws, found = [], []
    for split, values in (("held-out", held_out), ("train", train)):
        weights = resample_weights(values.size, ROOT, f"{task}/{split}")
        low, high = mean_intervals(values[None], weights)[0]
        found.append(
            Estimate(float(values.mean()), float(low), float(high), values.size, BOOTSTRAP)
        )
        draws.append(weights @ values / values.size)
    low, high = np.percentile(draws[0] - draws[1], PERCENTILES)
    value = found[0].value - found[1].value
    count = held_out.size + train.size
    difference = Estimate(value, float(low), float(high), count, BOOTSTRAP)
    return Gap(found[0], found[1], difference)


def _over_seeds(listed: Sequence[Episodes], task: str) -> Gap:
    """Estimate each split and the gap over training seeds."""
    means = np.array([[values.mean() for values in _splits(one, task)] for one in listed])
    rows = np.array([means[:, 0], means[:, 1], means[:, 0] - means[:, 1]])
    limits = mean_intervals(rows, resample_weights(len(listed), ROOT, f"seeds/{task}/gap"))
    held_out, train, difference = (
        Estimate(float(values.mean()), float(low), float(high), len(listed), OVER_SEEDS)
        for values, (low, high) in zip(rows, limits, strict=True)
    )
    return Gap(held_out, train, difference)
