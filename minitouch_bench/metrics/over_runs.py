"""Scores of several runs and tasks as one figure: interquartile mean and performance profile.

A score is a task's success in one run, 0 to 1. Both figures come with percentile bootstrap
intervals over the same resamples.

Source: R. Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice",
NeurIPS 2021. Written here because the authors' library ignores the seed that it is given.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from minitouch_bench.metrics.intervals import RESAMPLES
from minitouch_bench.records import Estimate

TRIMMED = 0.25
"""Share of the scores that is left out at each end."""

PERCENTILES = (2.5, 97.5)

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scores:
    """The scores of a method, (N,), and its sets of resamples, (RESAMPLES, N) each.

    An interval is no narrower than any of the sets makes it. ``over``: what was resampled.
    """

    values: Floats
    resampled: tuple[Floats, ...]
    over: str


def resample_scores(by_task: Sequence[Sequence[Estimate]], rng: np.random.Generator) -> Scores:
    """Return the scores of a method's runs, given task by task, with their resamples.

    Training seeds are resampled task by task. Shares over episodes are drawn from Jeffreys'
    posterior, which has a width at 0 and at 100 % too; a method of one run has these alone.
    """
    values = [np.array([one.value for one in own]) for own in by_task]
    counts = np.array([one.count for own in by_task for one in own])
    flat = np.concatenate(values)
    won = flat * counts
    episodes = rng.beta(won + 0.5, counts - won + 0.5, size=(RESAMPLES, flat.size))
    if all(own.size == 1 for own in values):
        return Scores(flat, (episodes,), "episodes")
    seeds = [own[rng.integers(own.size, size=(RESAMPLES, own.size))] for own in values]
    return Scores(flat, (np.concatenate(seeds, axis=1), episodes), "training seeds")


def interquartile_mean(scores: Scores) -> Estimate:
    """Estimate the mean of the middle half of the scores."""
    value = float(stats.trim_mean(scores.values, TRIMMED))
    drawn = [stats.trim_mean(one, TRIMMED, axis=1) for one in scores.resampled]
    ends = [np.percentile(one, PERCENTILES) for one in drawn]
    low, high = (
        min(value, *(float(one[0]) for one in ends)),
        max(value, *(float(one[1]) for one in ends)),
    )
    return Estimate(value, low, high, scores.values.size, f"bootstrap over {scores.over}")


def performance_profile(scores: Scores, thresholds: Floats) -> Floats:
    """Return the share of the scores above each threshold with its interval, (3, thresholds)."""
    shares = np.array([(scores.values > one).mean() for one in thresholds])
    lows, highs = [shares], [shares]
    for resampled in scores.resampled:
        drawn = np.array([(resampled > one).mean(axis=1) for one in thresholds])
        low, high = np.percentile(drawn, PERCENTILES, axis=1)
        lows.append(low)
        highs.append(high)
    return np.stack([shares, np.min(lows, axis=0), np.max(highs, axis=0)])
