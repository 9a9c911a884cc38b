"""What several runs show together: the interquartile mean, and performance profiles.

A score is a task's success in one run, 0 to 1. Both figures come with percentile bootstrap
intervals over the same resamples.

Source: R. Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice",
NeurIPS 2021. Written here because the authors' library ignores the seed that it is given.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.intervals import (
    INTERVAL_ENDS,
    RESAMPLES,
    bootstrap_mean,
    stream,
    wilson,
)
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import Estimate, SavedRun
from minitouch_bench.rendering.charts import (
    Chart,
    Figure,
    LegendItem,
    Line,
    Mark,
    Plot,
    interval_line,
    name_axis,
    run_dot,
    share_axis,
    short_names,
)
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.palette import series_tone
from minitouch_bench.rendering.tables import Cell, Column, Row, Table, estimate_cell
from minitouch_bench.reporting.labels import RunSection, listed, task_title
from minitouch_bench.reporting.tables import find_estimate

TRIMMED = 0.25
"""Share of the scores that is left out at each end."""
OVER_SEEDS = "bootstrap over training seeds, of a share no narrower than Wilson over all episodes"

Floats = NDArray[np.float64]


def over_seeds(
    estimates: Sequence[Estimate], rng: np.random.Generator, *, is_share: bool
) -> Estimate | None:
    """Estimate a metric over training seeds from what each found; of one seed what it found.

    A bootstrap never goes beyond the seeds' range. So few seeds that agree would have no interval
    at all; a share's is therefore no narrower than that of all their episodes together.
    """
    if len(estimates) < 2:
        return estimates[0] if estimates else None
    found = bootstrap_mean([one.value for one in estimates], rng)
    low, high = found.low, found.high
    if is_share:
        successes = sum(one.value * one.count for one in estimates)
        pooled = wilson(round(successes), sum(one.count for one in estimates))
        low, high = min(low, pooled.low), max(high, pooled.high)
    return Estimate(found.value, low, high, found.count, OVER_SEEDS)


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
    ends = [np.quantile(one, INTERVAL_ENDS) for one in drawn]
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
        low, high = np.quantile(drawn, INTERVAL_ENDS, axis=1)
        lows.append(low)
        highs.append(high)
    return np.stack([shares, np.min(lows, axis=0), np.max(highs, axis=0)])


ROOT = (0,)
"""Root of the random streams: the same runs give the same report."""

METRIC = "success"
THRESHOLDS = np.linspace(0.0, 1.0, 101)
HEIGHT = 130.0


@dataclass(frozen=True)
class RunOrigin:
    """The training that a run's policy comes from, "" and 0 where nothing says it."""

    method: str = ""
    steps: int = 0


@dataclass(frozen=True)
class Method:
    """The runs of one method: its training seeds, or one run alone."""

    name: str
    runs: tuple[SavedRun, ...]


def group_methods(
    sections: Sequence[RunSection], origins: Sequence[RunOrigin]
) -> tuple[Method, ...]:
    """Join runs of one method, steps, suite and conditions, which are its training seeds.

    A run whose origin is unknown stands alone, and so does another run of the same policy.
    """
    runs: dict[tuple[str, ...], list[SavedRun]] = {}
    for section, origin in zip(sections, origins, strict=True):
        header = section.run.header
        conditions = header.played_under.in_words()
        key = (origin.method, f"{origin.steps:,} steps", header.suite, *conditions)
        is_seed = origin.method and not any(
            one.header.policy.digest == header.policy.digest
            and {*one.header.tasks} & {*header.tasks}
            for one in runs.get(key, ())
        )
        runs.setdefault(key if is_seed else ("", section.name), []).append(section.run)
    same = Counter(key[0] for key in runs)
    names = (
        key[1] if not key[0] else key[0] if same[key[0]] == 1 else ", ".join(key) for key in runs
    )
    return tuple(
        Method(printable(name), tuple(own)) for name, own in zip(names, runs.values(), strict=True)
    )


def compare_methods(methods: Sequence[Method]) -> tuple[tuple[Table, ...], tuple[Figure, ...]]:
    """Return the table and the figure of several methods on the tasks that all of them have.

    None where there is nothing to join: one method, or one score each; and where a method has
    more runs of one task than of another, which would then count for more.
    """
    tasks = tuple(task for task in GOAL_TASKS if all(_estimates(one, task) for one in methods))
    counts = [[len(_estimates(one, task)) for task in tasks] for one in methods]
    joins_scores = sum(map(sum, counts)) > len(methods) > 1
    if not joins_scores or any(len(set(own)) > 1 for own in counts):
        return (), ()
    scores = [_scores(one, tasks) for one in methods]
    names = [one.name for one in methods]
    estimates = [interquartile_mean(one) for one in scores]
    rows = tuple(
        Row(
            (name,),
            (
                estimate_cell(METRIC, estimate),
                Cell(f"{one.values.mean():.3f}"),
                Cell(str(one.values.size)),
                Cell(one.over),
            ),
        )
        for name, estimate, one in zip(names, estimates, scores, strict=True)
    )
    joined = listed([task_title(task) for task in tasks])
    table = Table(
        "Over tasks and seeds",
        ("Method",),
        (
            Column("Interquartile mean"),
            Column("Mean"),
            Column("Scores"),
            Column("Interval over", is_text=True),
        ),
        rows,
        (
            f"A score: the success of one run in one task, of {joined}. Interquartile mean: the "
            "mean of the middle half of the scores. Brackets: 95 % interval over training seeds, "
            "percentile bootstrap task by task, no narrower than that over the episodes; where a "
            "method has one run, over its episodes alone.",
        ),
    )
    return (table,), (_figure(names, scores, estimates),)


def _figure(
    names: Sequence[str], scores: Sequence[Scores], estimates: Sequence[Estimate]
) -> Figure:
    means: list[Mark] = []
    profiles: list[Mark] = []
    for index, (one, estimate) in enumerate(zip(scores, estimates, strict=True)):
        means += [interval_line(index, index, estimate), run_dot(index, estimate.value, index)]
        rows = performance_profile(one, THRESHOLDS)
        for width, opacity, row in zip((1.6, 0.8, 0.8), (1.0, 0.35, 0.35), rows, strict=True):
            points = tuple(zip(THRESHOLDS.tolist(), row.tolist(), strict=True))
            profiles.append(Line(points, series_tone(index), width, opacity))
    rows_axis = name_axis(short_names(names))
    label = METRICS[METRIC].label
    return Figure(
        "over-tasks-and-seeds",
        "Over tasks and seeds",
        "Left: the interquartile mean of success with its 95 % interval. Right: the share of all "
        "scores above each success; faint: its 95 % interval.",
        (
            Plot(
                "Interquartile mean",
                "Interquartile mean of success with 95 % intervals",
                (Chart(share_axis(label), rows_axis, tuple(means), 23.0 * len(names)),),
            ),
            Plot(
                "Performance profile",
                "Share of the scores above each success",
                (
                    Chart(
                        share_axis(f"{label} τ"),
                        share_axis("Share above τ"),
                        tuple(profiles),
                        HEIGHT,
                    ),
                ),
            ),
        ),
        tuple(LegendItem(name, series_tone(index)) for index, name in enumerate(names)),
    )


def _estimates(method: Method, task: str) -> list[Estimate]:
    found = (find_estimate(run, task, METRIC) for run in method.runs)
    return [one for one in found if one is not None]


def _scores(method: Method, tasks: Sequence[str]) -> Scores:
    by_task = [_estimates(method, task) for task in tasks]
    return resample_scores(by_task, stream(ROOT, "over runs", method.name))
