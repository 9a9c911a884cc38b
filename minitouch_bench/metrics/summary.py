"""Estimates of a run, task by task."""

from collections.abc import Iterable, Sequence

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
    root = tuple(int(word) for word in rng.integers(2**32, size=4))
    tasks = run.header.tasks
    return Summary(
        tasks=tuple(_summarize_task(run, task, root) for task in tasks),
        generalization=generalize(measure_run(run), tasks, root),
    )


def measure_run(run: EvaluationRun, role: Role = Role.FINAL) -> tuple[EpisodeMetrics, ...]:
    """Measure every episode of one role, in the run's order."""
    return tuple(measure(record) for record in run.records if record.spec.role is role)


def _summarize_task(run: EvaluationRun, task: str, root: Root) -> TaskSummary:
    """Estimate the metrics of one task; a task without episodes has no estimates."""
    records = [record for record in run.records if record.spec.task == task]
    final = [record for record in records if record.spec.role is Role.FINAL]
    exploration = [record for record in records if record.spec.role is Role.EXPLORATION]
    episodes = [measure(record) for record in final]
    estimates: dict[str, Estimate] = {}
    if task in GOAL_TASKS:
        if exploration:
            estimates["exploration"] = _share(
                record.outcome is Outcome.SUCCESS for record in exploration
            )
        estimates.update(_goal_estimates(task, episodes, root))
    estimates.update(_touch_estimates(task, episodes, root))
    curve, counts = _touch_curve(final)
    return TaskSummary(
        task=task,
        estimates=estimates,
        outcomes={o.value: sum(e.outcome is o for e in episodes) for o in Outcome},
        touch_curve=curve,
        touch_curve_episodes=counts,
    )


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
