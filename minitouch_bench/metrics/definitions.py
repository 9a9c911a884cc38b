"""What a metric is, and every metric in one table.

Columns of ``episodes.csv``, estimates of ``run.json`` and its schema, rows of Table 4, columns
of the diagnostics and of the leaderboard all follow from METRICS. A new metric is an entry there
with its statistic. If it is derived from what episodes already hold, it is ``added_later``: stored
runs stay valid, their reports show a dash, and ``compare`` and ``regress`` compute it. If it is
measured in each episode, it also needs a field of ``episode.Episode``, which makes a new version of
``run.json`` (``runs.run.RUN_VERSION``); older runs are not read.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping
from enum import Flag, auto
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Episode, Outcome, PlayedEpisode, Role
from minitouch_bench.metrics.intervals import Bounds, Estimate
from minitouch_bench.metrics.statistics import MEAN, SHARE, Statistic
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL

UP = "↑"
DOWN = "↓"
NO_DIRECTION = ""

FORCES = PROTOCOL.observation.forces

CONTROL_STEPS = "control steps"
"""Unit of the metrics that no episode can have more of than its task has steps."""


class ShownIn(Flag):
    """Where a metric is shown, beside ``run.json``, which has them all."""

    NOWHERE = 0
    TABLE4 = auto()
    """A row of Table 4, and of the leaderboard's table of each task."""

    DIAGNOSTICS = auto()
    """A column of the diagnostics below Table 4."""

    BOARD = auto()
    """A column of the leaderboard's table of touch."""

    NOVEL_SHAPES = auto()
    """A row of the gaps between held-out and train shapes."""


Value = float | None
"""A metric's value in one episode; None where the episode has none."""


@dataclasses.dataclass(frozen=True)
class Metric:
    """What a metric is called, what it counts, and how it is measured and written.

    ``unit`` and ``direction`` (UP or DOWN where more or less is better) hold in every task
    except those named in ``task_units`` and ``task_directions``. ``source``: T (text of the
    paper), R (the released package) or D (decided here). ``number_format``: Python format of a
    value.

    ``measure`` reads a finished episode and fills ``field`` of Episode, by default the one
    of the metric's name. ``derive`` gives the metric's value in a measured episode, by default
    what that field holds. A metric has one of the two, or both. ``column`` of ``episodes.csv``
    holds the field of its name, or where there is none the value; "" for a metric that has no
    column.

    ``statistic``: what the episodes' values are condensed to. ``role``: whose episodes are counted.
    ``needs_goal``: only tasks with a goal have the metric. ``added_later``: there are runs without
    it, whose ``run.json`` stays valid; only a metric without ``measure`` can be.
    """

    name: str
    label: str
    unit: str
    source: str
    number_format: str
    meaning: str
    measure: Callable[[PlayedEpisode], Value] | None = None
    field: str = ""
    column: str = ""
    derive: Callable[[Episode], Value] | None = None
    direction: str = NO_DIRECTION
    statistic: Statistic = MEAN
    role: Role = Role.FINAL
    needs_goal: bool = False
    added_later: bool = False
    shown_in: ShownIn = ShownIn.NOWHERE
    task_units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    task_directions: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def value(self, episode: Episode) -> Value:
        """Return the metric's value in one episode; a share's is true or false."""
        if self.derive is not None:
            return self.derive(episode)
        measured: Value = getattr(episode, self.measured_field)
        return measured

    @property
    def measured_field(self) -> str:
        """The field of Episode that ``measure`` fills."""
        return self.field or self.name

    @property
    def is_fraction(self) -> bool:
        """Whether values lie between 0 and 1."""
        return self.unit.startswith("share")

    def range_in(self, task: str, *, difference: bool = False) -> Bounds:
        """Return the least and the greatest value in a task, or ``difference`` of two values.

        No metric is negative.
        """
        most = 1.0 if self.is_fraction else math.inf
        if self.unit == CONTROL_STEPS:
            most = PROTOCOL.task(task).max_steps
        return -most if difference else 0.0, most

    def is_in(self, task: str) -> bool:
        """Tell whether a task has this metric."""
        return not self.needs_goal or task in GOAL_TASKS

    def unit_in(self, task: str) -> str:
        """Return what the metric counts in a task."""
        return self.task_units.get(task, self.unit)

    def direction_in(self, task: str) -> str:
        """Return UP or DOWN where more or less is better in a task, else NO_DIRECTION."""
        return self.task_directions.get(task, self.direction)

    def values(self, episodes: Iterable[Episode]) -> list[float]:
        """Return the metric's values, one for each episode that has one."""
        return [float(value) for value in map(self.value, episodes) if value is not None]

    def estimate(self, episodes: Iterable[Episode], rng: np.random.Generator) -> Estimate | None:
        """Estimate the metric, None where no episode has a value."""
        values = self.values(episodes)
        if not values:
            return None
        return self.statistic.estimate(values, rng)


PLAYING_UP = {task.name: UP for task in PROTOCOL.tasks if not task.has_goal}
"""Better direction of touch: where a task has a goal, touching more is not better."""


def _contact_force(
    record: PlayedEpisode, condense: Callable[[NDArray[np.float64]], Any]
) -> float | None:
    """Condense the larger finger force (N) of the control steps with contact to one value."""
    touched = record.trace.contact_ticks > 0
    forces = record.trace.finger_force()[touched].astype(np.float64)
    return float(condense(forces)) if len(forces) else None


def _first_touch_tick(record: PlayedEpisode) -> int | None:
    tick = record.trace.first_touch_tick
    return None if tick < 0 else tick


def _time_to_first_touch(episode: Episode) -> float | None:
    tick = episode.first_touch_tick
    return None if tick is None else tick / PROTOCOL.physics.tick_rate


def _counted_steps(episode: Episode) -> int:
    """Return an episode's length; one that ends by a policy fault counts as long as possible.

    Otherwise a fault would improve results: fewer steps, and in Playing an end while the touch
    share is high.
    """
    has_fault = episode.outcome is Outcome.POLICY_FAULT
    return PROTOCOL.task(episode.task).max_steps if has_fault else episode.steps


def _touch_share(episode: Episode) -> float:
    steps = _counted_steps(episode)
    return episode.touch_steps / steps if steps else 0.0


def _axis_variances(samples: NDArray[Any]) -> NDArray[np.float64]:
    """Return the population variance of each column of (N, D) samples, float64 (D,)."""
    variances: NDArray[np.float64] = np.var(samples.astype(np.float64), axis=0)
    return variances


# fmt: off
_TABLE = (
    Metric(
        "exploration", "Exploration", "share of episodes", "T", ".3f",
        "episodes that succeed after training on intrinsic reward alone",
        direction=UP, statistic=SHARE, role=Role.EXPLORATION, needs_goal=True,
        derive=lambda episode: episode.success, shown_in=ShownIn.TABLE4,
    ),
    Metric(
        "success", "Success", "share of episodes", "T", ".3f", "episodes that succeed",
        direction=UP, statistic=SHARE, needs_goal=True, column="success",
        derive=lambda episode: episode.success, shown_in=ShownIn.TABLE4 | ShownIn.NOVEL_SHAPES,
    ),
    Metric(
        "episode_steps", "Episode steps", CONTROL_STEPS, "T", ".1f",
        "length of an episode, failures included; with a policy fault, the step limit",
        direction=DOWN, needs_goal=True, column="steps", field="steps",
        measure=lambda record: len(record.trace.actions), derive=_counted_steps,
        shown_in=ShownIn.TABLE4 | ShownIn.NOVEL_SHAPES,
    ),
    Metric(
        "steps_to_success", "Steps to success", CONTROL_STEPS, "D", ".1f",
        "length of an episode that succeeds", direction=DOWN, needs_goal=True,
        derive=lambda episode: episode.steps if episode.success else None,
        shown_in=ShownIn.DIAGNOSTICS,
    ),
    Metric(
        "return", "Return", "reward", "T", ".2f", "sum of the task's rewards",
        direction=UP, column="return", field="episode_return",
        measure=lambda record: float(record.trace.rewards.sum(dtype=np.float64)),
    ),
    Metric(
        "touch_interaction", "Touch-interaction", "ticks", "T", ".1f",
        "physics ticks with a finger in contact with the object",
        task_directions=PLAYING_UP, column="touch_interaction",
        measure=lambda record: int(record.trace.contact_ticks.sum(dtype=np.int64)),
        shown_in=ShownIn.TABLE4 | ShownIn.NOVEL_SHAPES,
    ),
    Metric(
        "touch_share", "Touch share", "share of control steps", "T", ".3f",
        "share of an episode's control steps with contact",
        task_directions=PLAYING_UP, column="touch_share", derive=_touch_share,
        shown_in=ShownIn.TABLE4 | ShownIn.NOVEL_SHAPES,
    ),
    Metric(
        "touched", "Touched", "share of episodes", "D", ".3f", "episodes with any contact",
        statistic=SHARE, derive=lambda episode: episode.touch_interaction > 0,
        shown_in=ShownIn.DIAGNOSTICS | ShownIn.BOARD,
    ),
    Metric(
        "touch_onsets", "Touch onsets", "contacts", "D", ".1f", "contacts begun",
        column="touch_onsets", measure=lambda record: int(record.trace.onsets.sum(dtype=np.int64)),
        shown_in=ShownIn.DIAGNOSTICS | ShownIn.BOARD,
    ),
    Metric(
        "touch_steps", "Touch steps", CONTROL_STEPS, "D", ".1f", "control steps with contact",
        column="touch_steps",
        measure=lambda record: int(np.count_nonzero(record.trace.contact_ticks)),
    ),
    Metric(
        "touch_variance", "Touch variance", "N²", "R", ".3g",
        "variance of the finger forces over the episode",
        column="touch_variance",
        measure=lambda record: float(_axis_variances(record.trace.touch[:, FORCES]).mean()),
    ),
    Metric(
        "peak_force", "Peak force", "N", "D", ".1f",
        "largest finger force of the control steps with contact, episodes that touched",
        column="peak_force", measure=lambda record: _contact_force(record, np.max),
        shown_in=ShownIn.DIAGNOSTICS | ShownIn.BOARD,
    ),
    Metric(
        "contact_force", "Contact force", "N", "D", ".1f",
        "mean finger force of the control steps with contact, episodes that touched",
        column="contact_force", measure=lambda record: _contact_force(record, np.mean),
        shown_in=ShownIn.DIAGNOSTICS | ShownIn.BOARD,
    ),
    Metric(
        "object_movement", "Object movement", "m²", "T", ".1e",
        "variance of the object's position, or of the door's angle, over the episode",
        task_units={task.name: task.movement_unit for task in PROTOCOL.tasks},
        column="object_movement",
        measure=lambda record: float(_axis_variances(record.trace.object_state).sum()),
        shown_in=ShownIn.DIAGNOSTICS | ShownIn.NOVEL_SHAPES,
    ),
    Metric(
        "time_to_first_touch", "First touch", "s", "D", ".2f",
        "simulated time to the first contact, episodes that touched",
        column="time_to_first_touch", field="first_touch_tick", measure=_first_touch_tick,
        derive=_time_to_first_touch, shown_in=ShownIn.DIAGNOSTICS | ShownIn.BOARD,
    ),
    Metric(
        "arm_time", "Arm time", "s", "D", ".2f", "simulated time of an episode",
        column="arm_time", field="ticks",
        measure=lambda record: int(record.trace.ticks.sum(dtype=np.int64)),
        derive=lambda episode: episode.ticks / PROTOCOL.physics.tick_rate,
        shown_in=ShownIn.DIAGNOSTICS,
    ),
    Metric(
        "clipped_actions", "Clipped actions", CONTROL_STEPS, "D", ".1f",
        "actions beyond -1 to 1, which are clipped", column="clipped_actions",
        measure=lambda record: int(np.count_nonzero(record.trace.clipped)),
        shown_in=ShownIn.DIAGNOSTICS,
    ),
)
# fmt: on

METRICS: Mapping[str, Metric] = {metric.name: metric for metric in _TABLE}
"""The metrics by name, in the order of every table."""


def metrics_shown_in(table: ShownIn, task: str | None = None) -> tuple[str, ...]:
    """Return the names of the metrics that a table shows, of those that ``task`` has."""
    return tuple(
        metric.name
        for metric in METRICS.values()
        if table in metric.shown_in and (task is None or metric.is_in(task))
    )


def intervals_in_words(metrics: Iterable[str]) -> str:
    """Say how the intervals of some metrics are made: "Wilson for shares, ..."."""
    return ", ".join(dict.fromkeys(METRICS[metric].statistic.interval for metric in metrics))


def ranking_metric(task: str) -> str:
    """Return the metric that sums a task up and ranks it: success, or how much is touched."""
    return "success" if task in GOAL_TASKS else "touch_share"
