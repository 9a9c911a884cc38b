"""The metrics of each episode, and from them the estimates of a run, task by task."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.generalization import generalize
from minitouch_bench.metrics.intervals import Root, stream
from minitouch_bench.records import (
    EpisodeMetrics,
    EpisodeRecord,
    EvaluationRun,
    Outcome,
    Role,
    Summary,
    TaskSummary,
)


def measure(record: EpisodeRecord) -> EpisodeMetrics:
    """Measure one episode; a policy that failed before its first step gives zeros.

    Source: Table 4 and Figures 3 and 9 of the paper; ``docs/metrics.md`` defines each metric.
    """
    spec = record.spec
    measured = {
        metric.field or metric.name: metric.measure(record)
        for metric in METRICS.values()
        if metric.measure is not None
    }
    return EpisodeMetrics(
        task=spec.task,
        index=spec.index,
        seed=spec.seed,
        shape=spec.shape,
        family=spec.family,
        split=spec.split,
        outcome=record.outcome,
        digest=record.trace.digest(),
        **measured,  # type: ignore[arg-type]  # each measured as its field is typed
    )


def summarize(run: EvaluationRun, rng: np.random.Generator) -> Summary:
    """Estimate every metric of every task of a run, in the run's order of tasks.

    ``rng`` gives one root seed. Each (task, metric) draws from its own stream under it, so
    an estimate does not depend on which other tasks were run.
    """
    episodes, exploration = measure_run(run), measure_run(run, Role.EXPLORATION)
    summary = summarize_episodes(run.header.tasks, episodes, exploration, rng)
    return replace(summary, tasks=tuple(_with_touch_curve(task, run) for task in summary.tasks))


def summarize_episodes(
    tasks: Sequence[str],
    episodes: Sequence[EpisodeMetrics],
    exploration: Sequence[EpisodeMetrics],
    rng: np.random.Generator,
) -> Summary:
    """Estimate what ``summarize`` does from measured episodes: all but the touch curves."""
    root = tuple(int(word) for word in rng.integers(2**32, size=4))
    return Summary(
        tasks=tuple(_summarize_task(task, episodes, exploration, root) for task in tasks),
        generalization=generalize(episodes, tasks, root),
    )


def measure_run(run: EvaluationRun, role: Role = Role.FINAL) -> tuple[EpisodeMetrics, ...]:
    """Measure every episode of one role, in the run's order."""
    return tuple(measure(record) for record in run.records if record.spec.role is role)


def _summarize_task(
    task: str,
    episodes: Sequence[EpisodeMetrics],
    exploration: Sequence[EpisodeMetrics],
    root: Root,
) -> TaskSummary:
    """Estimate the metrics of one task; a task without episodes has no estimates."""
    own = {
        Role.FINAL: [episode for episode in episodes if episode.task == task],
        Role.EXPLORATION: [episode for episode in exploration if episode.task == task],
    }
    found = {
        name: metric.estimate(own[metric.role], stream(root, task, name))
        for name, metric in METRICS.items()
        if metric.is_in(task)
    }
    return TaskSummary(
        task=task,
        estimates={name: figure for name, figure in found.items() if figure is not None},
        outcomes={o: sum(e.outcome is o for e in own[Role.FINAL]) for o in Outcome},
        touch_curve=(),
    )


def _with_touch_curve(summary: TaskSummary, run: EvaluationRun) -> TaskSummary:
    """Add what only the trajectories tell."""
    curve, counts = _touch_curve(
        [r for r in run.records if r.spec.task == summary.task and r.spec.role is Role.FINAL]
    )
    return replace(summary, touch_curve=curve, touch_curve_episodes=counts)


def _touch_curve(
    records: Sequence[EpisodeRecord],
) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """Return the mean contact ticks at each control step, and the episodes that reached it."""
    longest = max((len(record.trace.contact_ticks) for record in records), default=0)
    total: NDArray[np.int64] = np.zeros(longest, dtype=np.int64)
    reached: NDArray[np.int64] = np.zeros(longest, dtype=np.int64)
    for record in records:
        ticks = record.trace.contact_ticks
        total[: len(ticks)] += ticks
        reached[: len(ticks)] += 1
    return tuple((total / reached).tolist()), tuple(reached.tolist())
