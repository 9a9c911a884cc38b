"""What several runs show together: the interquartile mean, and performance profiles.

A score is a task's success in one run, 0 to 1. Both come with percentile bootstrap intervals over
the same resamples.

Source: R. Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice",
NeurIPS 2021. Written here because the authors' library ignores the seed that it is given.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy
from numpy.typing import NDArray

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.intervals import INTERVAL_ENDS, RESAMPLES, stream
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import Estimate
from minitouch_bench.rendering import charts
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.tables import Table, estimate_cell, make_columns, make_row
from minitouch_bench.reporting.labels import RunOrigin, RunSection, listed, task_title
from minitouch_bench.reporting.long_frame import (
    RunLabel,
    estimates_in,
    frame_rows,
    make_long_frame,
    repeats_policy,
    select,
)

TRIMMED = 0.25
"""Share of the scores that is left out at each end."""

METRIC = "success"
THRESHOLDS = np.linspace(0.0, 1.0, 101)
HEIGHT = 130.0

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
    values = [np.array([run.value for run in runs]) for runs in by_task]
    counts = np.array([run.count for runs in by_task for run in runs])
    flat = np.concatenate(values)
    won = flat * counts
    episodes = rng.beta(won + 0.5, counts - won + 0.5, size=(RESAMPLES, flat.size))
    if all(runs.size == 1 for runs in values):
        return Scores(flat, (episodes,), "episodes")
    seeds = [runs[rng.integers(runs.size, size=(RESAMPLES, runs.size))] for runs in values]
    return Scores(flat, (np.concatenate(seeds, axis=1), episodes), "training seeds")


def interquartile_mean(scores: Scores) -> Estimate:
    """Estimate the mean of the middle half of the scores."""
    value = float(scipy.stats.trim_mean(scores.values, TRIMMED))
    means = [scipy.stats.trim_mean(resampled, TRIMMED, axis=1) for resampled in scores.resampled]
    ends = np.array([np.quantile(sample, INTERVAL_ENDS) for sample in means])
    low, high = min(value, float(ends[:, 0].min())), max(value, float(ends[:, 1].max()))
    return Estimate(value, low, high, scores.values.size, f"bootstrap of scores over {scores.over}")


def performance_profile(scores: Scores, thresholds: Floats) -> Floats:
    """Return the share of the scores above each threshold with its interval, (3, thresholds)."""
    shares = np.array([(scores.values > threshold).mean() for threshold in thresholds])
    lows, highs = [shares], [shares]
    for resampled in scores.resampled:
        shares_drawn = np.array([(resampled > threshold).mean(axis=1) for threshold in thresholds])
        low, high = np.quantile(shares_drawn, INTERVAL_ENDS, axis=1)
        lows.append(low)
        highs.append(high)
    return np.stack([shares, np.min(lows, axis=0), np.max(highs, axis=0)])


def label_methods(
    sections: Sequence[RunSection], origins: Sequence[RunOrigin]
) -> tuple[RunLabel, ...]:
    """Say of each run which method it is of, and which training seed of it.

    Runs of one method, steps, suite and conditions are its training seeds. A run whose origin is
    unknown is a method alone, and so is another run of the same policy; where a method has its
    name, "(run)" follows it.
    """
    seeds: dict[tuple[str, ...], list[RunSection]] = {}
    keys = []
    for section, origin in zip(sections, origins, strict=True):
        header = section.run.header
        conditions = header.plan.conditions.in_words()
        key: tuple[str, ...] = (
            origin.method,
            f"{origin.steps:,} steps",
            header.plan.suite,
            *conditions,
        )
        is_seed = origin.method and not any(
            repeats_policy(section.run, other.run) for other in seeds.get(key, ())
        )
        keys.append(key if is_seed else ("", section.name))
        seeds.setdefault(keys[-1], []).append(section)
    same = Counter(key[0] for key in seeds)
    labels = []
    for section, origin, key in zip(sections, origins, keys, strict=True):
        if not key[0]:
            name = f"{key[1]} (run)" if key[1] in same else key[1]
        else:
            name = key[0] if same[key[0]] == 1 else ", ".join(key)
        labels.append(RunLabel(printable(name), seeds[key].index(section), origin.steps))
    return tuple(labels)


def compare_methods(
    labels: Sequence[RunLabel], sections: Sequence[RunSection]
) -> tuple[tuple[Table, ...], tuple[charts.Figure, ...]]:
    """Return the table and the figure of several methods on the tasks that all of them have.

    None of either where there is nothing to join: one method, or one score each; and where a
    method has more runs of one task than of another, which would then count for more.
    """
    rows = (
        row
        for label, section in zip(labels, sections, strict=True)
        for row in frame_rows(label, section.run)
    )
    frame = select(make_long_frame(rows), metric=METRIC)
    names = [*dict.fromkeys(label.method for label in labels)]
    counts = pd.crosstab(frame["method"], frame["task"]).reindex(names, fill_value=0)
    tasks = [task for task in GOAL_TASKS if task in counts and counts[task].all()]
    counts = counts[tasks]
    joins_scores = counts.to_numpy().sum() > len(names) > 1
    if not joins_scores or (counts.nunique(axis=1) > 1).any():
        return (), ()
    scores = {name: _scores(select(frame, method=name), name, tasks) for name in names}
    estimates = [interquartile_mean(method_scores) for method_scores in scores.values()]
    return (_table(scores, estimates, tasks),), (_figure(scores, estimates),)


def _scores(frame: pd.DataFrame, name: str, tasks: Sequence[str]) -> Scores:
    by_task = [estimates_in(select(frame, task=task)) for task in tasks]
    return resample_scores(by_task, stream((0,), "over runs", name))


def _table(
    scores: Mapping[str, Scores], estimates: Sequence[Estimate], tasks: Sequence[str]
) -> Table:
    rows = tuple(
        make_row(
            name,
            estimate_cell(METRIC, estimate),
            f"{method_scores.values.mean():.3f}",
            str(method_scores.values.size),
            method_scores.over,
        )
        for (name, method_scores), estimate in zip(scores.items(), estimates, strict=True)
    )
    over = "Interval over"
    return Table(
        "Over tasks and seeds",
        ("Method",),
        make_columns("Interquartile mean", "Mean", "Scores", over, words=[over]),
        rows,
        (
            "A score: the success of one run in one task, of "
            f"{listed([task_title(task) for task in tasks])}. Interquartile mean: the "
            "mean of the middle half of the scores. Brackets: 95 % interval over training seeds, "
            "percentile bootstrap task by task, no narrower than that over the episodes; where a "
            "method has one run, over its episodes alone.",
        ),
    )


def _figure(scores: Mapping[str, Scores], estimates: Sequence[Estimate]) -> charts.Figure:
    means: list[charts.Mark] = []
    profiles: list[charts.Mark] = []
    for turn, (method_scores, estimate) in enumerate(zip(scores.values(), estimates, strict=True)):
        means += charts.estimate_marks(turn, turn, estimate)
        profiles += charts.line_with_band(
            turn, THRESHOLDS, *performance_profile(method_scores, THRESHOLDS)
        )
    label = METRICS[METRIC].label
    rows = charts.name_axis(charts.short_names([*scores]))
    mean = charts.Chart(charts.share_axis(label), rows, tuple(means), charts.ROW * len(scores))
    profile = charts.Chart(
        charts.share_axis(f"{label} τ"),
        charts.share_axis("Share above τ"),
        charts.bands_first(profiles),
        HEIGHT,
    )
    title = "Interquartile mean"
    return charts.Figure(
        "over-tasks-and-seeds",
        "Over tasks and seeds",
        "Left: the interquartile mean of success with its 95 % interval. Right: the share of all "
        "scores above each success, and its 95 % interval.",
        (
            charts.Plot(title, f"{title} of success with 95 % intervals", (mean,)),
            charts.Plot(
                "Performance profile", "Share of the scores above each success", (profile,)
            ),
        ),
        charts.run_legend([*scores]),
    )
