"""What several runs show together: the interquartile mean, and performance profiles."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.intervals import stream
from minitouch_bench.metrics.over_runs import (
    Scores,
    interquartile_mean,
    performance_profile,
    resample_scores,
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

    A run whose origin is unknown stands alone.
    """
    runs: dict[tuple[str, ...], list[SavedRun]] = {}
    for section, origin in zip(sections, origins, strict=True):
        header = section.run.header
        conditions = header.played_under.in_words()
        key = (origin.method, f"{origin.steps:,} steps", header.suite, *conditions)
        runs.setdefault(key if origin.method else ("", section.name), []).append(section.run)
    same = Counter(key[0] for key in runs)
    names = (
        key[1] if not key[0] else key[0] if same[key[0]] == 1 else ", ".join(key) for key in runs
    )
    return tuple(
        Method(printable(name), tuple(own)) for name, own in zip(names, runs.values(), strict=True)
    )


def compare_methods(methods: Sequence[Method]) -> tuple[tuple[Table, ...], tuple[Figure, ...]]:
    """Return the table and the figure of several methods on the tasks that all of them have.

    None where there is nothing to join: one method, or one score each.
    """
    tasks = tuple(task for task in GOAL_TASKS if all(_estimates(one, task) for one in methods))
    if len(methods) < 2 or sum(
        len(_estimates(one, task)) for one in methods for task in tasks
    ) <= len(methods):
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
    return (table,), (_figure(names, scores),)


def _figure(names: Sequence[str], scores: Sequence[Scores]) -> Figure:
    means: list[Mark] = []
    profiles: list[Mark] = []
    for index, one in enumerate(scores):
        estimate = interquartile_mean(one)
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
