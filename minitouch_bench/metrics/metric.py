"""What a metric is: how it is measured, estimated and written, and where it is shown."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum

import numpy as np

from minitouch_bench.metrics.intervals import Range
from minitouch_bench.metrics.statistics import MEAN, Statistic
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.records import EpisodeMetrics, EpisodeRecord, Estimate, Role

UP = "↑"
DOWN = "↓"
NO_DIRECTION = ""

CONTROL_STEPS = "control steps"
"""Unit of the metrics that no episode can have more of than its task has steps."""


class ShownIn(StrEnum):
    """Where a metric is shown, beside ``run.json``, which has them all."""

    TABLE4 = "table4"
    """A row of Table 4, and of the leaderboard's table of each task."""

    DIAGNOSTICS = "diagnostics"
    """A column of the diagnostics below Table 4."""

    BOARD = "board"
    """A column of the leaderboard's table of touch."""

    NOVEL_SHAPES = "novel-shapes"
    """A row of the gaps between held-out and train shapes."""


Value = float | None
"""A metric's value in one episode; None where the episode has none."""

Bounds = tuple[float, float] | None
"""The least and the greatest value that is possible; None where there can be none."""

NON_NEGATIVE: Bounds = (0.0, math.inf)


@dataclasses.dataclass(frozen=True)
class Metric:
    """What a metric is called, what it counts, and how it is measured and written.

    ``unit`` and ``direction`` (UP or DOWN where more or less is better) hold in every task
    except those named in ``task_units`` and ``task_directions``. ``source``: T (text of the
    paper), R (the released package) or D (decided here). ``number_format``: Python format of a
    value.

    ``measure`` reads a finished episode and fills ``field`` of EpisodeMetrics, by default the one
    of the metric's name. ``derive`` gives the metric's value in a measured episode, by default
    what that field holds. A metric has one of the two, or both. ``possible`` gives what the field
    can hold beside what the others do: a submission with another value is refused. ``column`` of
    ``episodes.csv`` holds the field of its name, or where there is none the value; "" for a metric
    that has no column.

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
    measure: Callable[[EpisodeRecord], Value] | None = None
    possible: Callable[[EpisodeMetrics], Bounds] = lambda _: NON_NEGATIVE
    field: str = ""
    column: str = ""
    derive: Callable[[EpisodeMetrics], Value] | None = None
    direction: str = NO_DIRECTION
    statistic: Statistic = MEAN
    role: Role = Role.FINAL
    needs_goal: bool = False
    added_later: bool = False
    shown_in: frozenset[ShownIn] = frozenset()
    task_units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    task_directions: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.statistic, Statistic):
            raise TypeError(f"the metric {self.name} has no statistic: {self.statistic!r}")
        if self.added_later and self.measure is not None:
            raise ValueError(f"stored episodes do not hold what {self.name} measures")

    def value(self, episode: EpisodeMetrics) -> Value:
        """Return the metric's value in one episode; a share's is true or false."""
        if self.derive is not None:
            return self.derive(episode)
        measured: Value = getattr(episode, self.measured_field)
        return measured

    def cell(self, episode: EpisodeMetrics) -> Value:
        """Return what the metric's column of ``episodes.csv`` contains."""
        if self.measure is None or self.column != self.measured_field:
            return self.value(episode)
        measured: Value = getattr(episode, self.column)
        return measured

    @property
    def measured_field(self) -> str:
        """The field of EpisodeMetrics that ``measure`` fills."""
        return self.field or self.name

    def contradiction(self, episode: EpisodeMetrics) -> str:
        """Say in words what is measured and not possible; "" if nothing."""
        if self.measure is None:
            return ""
        measured: Value = getattr(episode, self.measured_field)
        bounds = self.possible(episode)
        if measured is None or bounds is None:
            fits = measured is None and bounds is None
        else:
            fits = bounds[0] <= measured <= bounds[1]
        said = "None" if measured is None else f"{measured:g}"
        return "" if fits else f"{self.measured_field} is {said}, not {_in_words(bounds)}"

    @property
    def is_share(self) -> bool:
        """Whether values lie between 0 and 1."""
        return self.unit.startswith("share")

    def range_in(self, task: str, *, difference: bool = False) -> Range:
        """Return the least and the greatest value in a task, or ``difference`` of two values.

        No metric is negative.
        """
        most = 1.0 if self.is_share else math.inf
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

    def values(self, episodes: Iterable[EpisodeMetrics]) -> list[float]:
        """Return the metric's values, one for each episode that has one."""
        return [float(value) for value in map(self.value, episodes) if value is not None]

    def estimate(
        self, episodes: Iterable[EpisodeMetrics], rng: np.random.Generator
    ) -> Estimate | None:
        """Estimate the metric, None where no episode has a value."""
        values = self.values(episodes)
        if not values:
            return None
        return self.statistic.estimate(values, rng)


def _in_words(bounds: Bounds) -> str:
    if bounds is None:
        return "None"
    low, high = bounds
    if low == high:
        return f"{low:g}"
    return f"{low:g} or more" if high == math.inf else f"{low:g} to {high:g}"
