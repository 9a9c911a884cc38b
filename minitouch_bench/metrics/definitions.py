"""Every metric in one table.

Columns of ``episodes.csv``, estimates of ``run.json`` and its schema, rows of Table 4, columns
of the diagnostics and of the leaderboard, and what a submission's episodes are checked for, all
follow from METRICS. A new metric is an entry here, and a field of ``records.EpisodeMetrics`` if
it is measured in each episode; the field makes a new version of ``run.json``
(``records.RUN_VERSION``), and older runs are not read.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.metrics.metric import DOWN, UP, Bounds, Kind, Metric, ShownIn
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.records import EpisodeMetrics, EpisodeRecord, Outcome, Role

FORCE_COMPONENTS = slice(5, 11)
"""Columns of the touch vector that hold the two fingers' forces, N."""

FINGERS = 2


def _touch_variance(record: EpisodeRecord) -> float:
    return float(_axis_variances(record.trace.touch[:, FORCE_COMPONENTS]).mean())


def _object_movement(record: EpisodeRecord) -> float:
    return float(_axis_variances(record.trace.object_state).sum())


def _first_touch_tick(record: EpisodeRecord) -> int | None:
    tick = record.trace.first_touch_tick
    return None if tick < 0 else tick


def _time_to_first_touch(episode: EpisodeMetrics) -> float | None:
    tick = episode.first_touch_tick
    return None if tick is None else tick / PROTOCOL.physics.tick_rate


def _touched(episode: EpisodeMetrics) -> bool:
    return episode.touch_interaction > 0


def _possible_steps(episode: EpisodeMetrics) -> Bounds:
    least = 0 if episode.outcome is Outcome.POLICY_FAULT else 1
    return least, PROTOCOL.task(episode.task).max_steps


def _axis_variances(
    samples: NDArray[np.float32] | NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the population variance of each column of (N, D) samples, as (D,)."""
    if len(samples) == 0:
        return np.zeros(samples.shape[1])
    variances: NDArray[np.float64] = np.var(samples.astype(np.float64), axis=0)
    return variances


_TABLE = (
    Metric(
        name="exploration",
        label="Exploration",
        unit="share of episodes",
        direction=UP,
        source="T",
        number_format=".3f",
        meaning="episodes that succeed after training on intrinsic reward alone",
        derive=lambda episode: episode.success,
        kind=Kind.SHARE,
        role=Role.EXPLORATION,
        needs_goal=True,
        shown_in=frozenset({ShownIn.TABLE4}),
    ),
    Metric(
        name="success",
        label="Success",
        column="success",
        unit="share of episodes",
        direction=UP,
        source="T",
        number_format=".3f",
        meaning="episodes that succeed",
        derive=lambda episode: episode.success,
        kind=Kind.SHARE,
        needs_goal=True,
        shown_in=frozenset({ShownIn.TABLE4, ShownIn.NOVEL_SHAPES}),
    ),
    Metric(
        name="episode_steps",
        label="Episode steps",
        column="steps",
        unit="control steps",
        direction=DOWN,
        source="T",
        number_format=".1f",
        meaning="length of an episode, failures included",
        measure=lambda record: len(record.trace.actions),
        possible=_possible_steps,
        field="steps",
        needs_goal=True,
        shown_in=frozenset({ShownIn.TABLE4, ShownIn.NOVEL_SHAPES}),
    ),
    Metric(
        name="steps_to_success",
        label="Steps to success",
        unit="control steps",
        direction=DOWN,
        source="D",
        number_format=".1f",
        meaning="length of an episode that succeeds",
        derive=lambda episode: episode.steps if episode.success else None,
        needs_goal=True,
        shown_in=frozenset({ShownIn.DIAGNOSTICS}),
    ),
    Metric(
        name="return",
        label="Return",
        column="return",
        unit="reward",
        direction=UP,
        source="T",
        number_format=".2f",
        meaning="sum of the task's rewards",
        measure=lambda record: float(record.trace.rewards.sum(dtype=np.float64)),
        possible=lambda e: PROTOCOL.task(e.task).possible_return(e.steps, success=e.success),
        field="episode_return",
    ),
    Metric(
        name="touch_interaction",
        label="Touch-interaction",
        column="touch_interaction",
        unit="ticks",
        task_directions={task.name: UP for task in PROTOCOL.tasks if not task.has_goal},
        source="T",
        number_format=".1f",
        meaning="physics ticks with a finger in contact with the object",
        measure=lambda record: int(record.trace.contact_ticks.sum(dtype=np.int64)),
        possible=lambda e: (0, e.ticks),
        shown_in=frozenset({ShownIn.TABLE4, ShownIn.NOVEL_SHAPES}),
    ),
    Metric(
        name="touch_share",
        label="Touch share",
        unit="share of control steps",
        direction=UP,
        source="T",
        number_format=".3f",
        meaning="share of an episode's control steps with contact",
        derive=lambda episode: episode.touch_steps / episode.steps if episode.steps else 0.0,
        shown_in=frozenset({ShownIn.TABLE4, ShownIn.NOVEL_SHAPES}),
    ),
    Metric(
        name="touched",
        label="Touched",
        unit="share of episodes",
        source="D",
        number_format=".3f",
        meaning="episodes with any contact",
        derive=_touched,
        kind=Kind.SHARE,
        shown_in=frozenset({ShownIn.DIAGNOSTICS, ShownIn.BOARD}),
    ),
    Metric(
        name="touch_onsets",
        label="Touch onsets",
        column="touch_onsets",
        unit="contacts",
        source="D",
        number_format=".1f",
        meaning="contacts begun",
        measure=lambda record: int(record.trace.onsets.sum(dtype=np.int64)),
        possible=lambda e: (_touched(e), FINGERS * e.touch_interaction),
        shown_in=frozenset({ShownIn.DIAGNOSTICS, ShownIn.BOARD}),
    ),
    Metric(
        name="touch_steps",
        label="Touch steps",
        column="touch_steps",
        unit="control steps",
        source="D",
        number_format=".1f",
        meaning="control steps with contact",
        measure=lambda record: int(np.count_nonzero(record.trace.contact_ticks)),
        possible=lambda e: (_touched(e), min(e.steps, e.touch_interaction)),
    ),
    Metric(
        name="touch_variance",
        label="Touch variance",
        column="touch_variance",
        unit="N²",
        source="R",
        number_format=".3g",
        meaning="variance of the finger forces over the episode",
        measure=_touch_variance,
    ),
    Metric(
        name="object_movement",
        label="Object movement",
        column="object_movement",
        unit="m²",
        task_units={task.name: task.movement_unit for task in PROTOCOL.tasks},
        source="T",
        number_format=".1e",
        meaning="variance of the object's position, or of the door's angle, over the episode",
        measure=_object_movement,
        shown_in=frozenset({ShownIn.DIAGNOSTICS, ShownIn.NOVEL_SHAPES}),
    ),
    Metric(
        name="time_to_first_touch",
        label="First touch",
        column="time_to_first_touch",
        unit="s",
        source="D",
        number_format=".2f",
        meaning="simulated time to the first contact, episodes that touched",
        measure=_first_touch_tick,
        possible=lambda e: (0, e.ticks - 1) if _touched(e) else None,
        field="first_touch_tick",
        derive=_time_to_first_touch,
        shown_in=frozenset({ShownIn.DIAGNOSTICS, ShownIn.BOARD}),
    ),
    Metric(
        name="arm_time",
        label="Arm time",
        column="arm_time",
        unit="s",
        source="D",
        number_format=".2f",
        meaning="simulated time of an episode",
        measure=lambda record: int(record.trace.ticks.sum(dtype=np.int64)),
        possible=lambda e: (e.steps, e.steps * PROTOCOL.control.max_ticks),
        field="ticks",
        derive=lambda episode: episode.ticks / PROTOCOL.physics.tick_rate,
        shown_in=frozenset({ShownIn.DIAGNOSTICS}),
    ),
    Metric(
        name="clipped_actions",
        label="Clipped actions",
        column="clipped_actions",
        unit="control steps",
        source="D",
        number_format=".1f",
        meaning="actions beyond -1 to 1, which are clipped",
        measure=lambda record: int(np.count_nonzero(record.trace.clipped)),
        possible=lambda e: (0, e.steps),
        shown_in=frozenset({ShownIn.DIAGNOSTICS}),
    ),
)

METRICS: Mapping[str, Metric] = MappingProxyType({metric.name: metric for metric in _TABLE})
"""The metrics by name, in the order of every table."""


def metrics_shown_in(table: ShownIn, task: str | None = None) -> tuple[str, ...]:
    """Return the names of the metrics that a table shows, of those that ``task`` has."""
    return tuple(
        metric.name
        for metric in _TABLE
        if table in metric.shown_in and (task is None or metric.is_in(task))
    )


def ranking_metric(task: str) -> str:
    """Return the metric that sums a task up and ranks it: success, or how much is touched."""
    return "success" if task in GOAL_TASKS else "touch_share"
