"""Estimates of a run, task by task."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.metrics.episode import measure
from minitouch_bench.metrics.generalization import generalize
from minitouch_bench.metrics.intervals import bootstrap_mean, wilson
from minitouch_bench.metrics.streams import Root, stream
from minitouch_bench.records import (
    GOAL_TASKS,
    EpisodeMetrics,
    EpisodeRecord,
    Estimate,
    EvaluationRun,
    Outcome,
    Role,
    Summary,
    TaskSummary,
)

MEANS_OF_EVERY_TASK = (
    "touch_interaction",
    "touch_onsets",
    "touch_steps",
    "touch_variance",
    "object_movement",
    "arm_time",
    "return",
    "clipped_actions",
)
"""Metrics that are plain means over all episodes of a task."""

_ATTRIBUTES = {"return": "episode_return"}


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
    own = [episode for episode in episodes if episode.task == task]
    explored = [episode for episode in exploration if episode.task == task]
    estimates: dict[str, Estimate] = {}
    if task in GOAL_TASKS:
        if explored:
            estimates["exploration"] = _share(episode.success for episode in explored)
        estimates.update(_goal_estimates(task, own, root))
    estimates.update(_touch_estimates(task, own, root))
    outcomes = {outcome.value: sum(e.outcome is outcome for e in own) for outcome in Outcome}
    return TaskSummary(task=task, estimates=estimates, outcomes=outcomes, touch_curve=())


def _with_touch_curve(summary: TaskSummary, run: EvaluationRun) -> TaskSummary:
    """Add what only the trajectories tell."""
    curve, counts = _touch_curve(
        [r for r in run.records if r.spec.task == summary.task and r.spec.role is Role.FINAL]
    )
    return replace(summary, touch_curve=curve, touch_curve_episodes=counts)


def _goal_estimates(
    task: str, episodes: Sequence[EpisodeMetrics], root: Root
) -> dict[str, Estimate]:
    """Estimate what only a task with a goal has."""
    if not episodes:
        return {}
    steps = [episode.steps for episode in episodes]
    estimates = {
        "success": _share(episode.success for episode in episodes),
        "episode_steps": bootstrap_mean(steps, stream(root, task, "episode_steps")),
    }
    won = [episode.steps for episode in episodes if episode.success]
    if won:
        rng = stream(root, task, "steps_to_success")
        estimates["steps_to_success"] = bootstrap_mean(won, rng)
    return estimates


def _touch_estimates(
    task: str, episodes: Sequence[EpisodeMetrics], root: Root
) -> dict[str, Estimate]:
    """Estimate what every task has."""
    if not episodes:
        return {}
    estimates = {"touched": _share(episode.touch_interaction > 0 for episode in episodes)}
    for metric in MEANS_OF_EVERY_TASK:
        values = [float(getattr(e, _ATTRIBUTES.get(metric, metric))) for e in episodes]
        estimates[metric] = bootstrap_mean(values, stream(root, task, metric))
    times = [e.time_to_first_touch for e in episodes if e.time_to_first_touch is not None]
    if times:
        rng = stream(root, task, "time_to_first_touch")
        estimates["time_to_first_touch"] = bootstrap_mean(times, rng)
    return estimates


def _share(flags: Iterable[bool]) -> Estimate:
    """Estimate the share of true flags."""
    listed = list(flags)
    return wilson(sum(listed), len(listed))


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
