"""The metrics of each episode, and from them the estimates of a run: by task, and by split.

Both are data frames too.
"""

import html
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Count, Episode, Outcome, PlayedEpisode, Role
from minitouch_bench.metrics.definitions import (
    METRICS,
    Metric,
    ShownIn,
    metrics_shown_in,
    ranking_metric,
)
from minitouch_bench.metrics.intervals import Estimate, Root, stream
from minitouch_bench.protocol.spec import Split
from minitouch_bench.text import printable

if TYPE_CHECKING:
    import pandas as pd

MIN_EPISODES = 10
"""Episodes of each split below which a gap would be noise alone."""


TABLE4_METRICS = metrics_shown_in(ShownIn.TABLE4)

_IDENTITY = ("task", "index", "seed", "shape", "outcome")
_MEASURED = tuple(metric for metric in METRICS.values() if metric.column)
EPISODE_COLUMNS = (*_IDENTITY, *(metric.column for metric in _MEASURED))
"""Columns of ``episodes.csv``."""


class Quartiles(NamedTuple):
    """A distribution over episodes: its lower quartile, median and upper quartile."""

    lower: float
    median: float
    upper: float


@dataclass(frozen=True, repr=False)
class TaskResult:
    """The results of one task: each metric is an attribute, an estimate with its interval.

    ``result.success`` is an ``Estimate`` with ``value``, ``low``, ``high`` (95 %), ``count``
    and ``method``. ``outcomes``: number of episodes by how they ended. The curves have a value for
    each control step, over the episodes that reached it, whose number is in ``curve_episodes``:
    ``touch_curve`` has the mean contact ticks, ``force_curve`` the quartiles (N) of the larger
    finger force.
    """

    task: str
    estimates: Mapping[str, Estimate]
    outcomes: Mapping[Outcome, Count]
    touch_curve: tuple[float, ...] = ()
    force_curve: tuple[Quartiles, ...] = ()
    curve_episodes: tuple[Count, ...] = ()

    def to_frame(self) -> "pd.DataFrame":
        """Return a row per metric: label, unit, value, low and high (95 %), count, method."""
        import pandas as pd  # noqa: PLC0415  takes half a second

        rows = {
            name: {"label": METRICS[name].label, "unit": METRICS[name].unit_in(self.task)}
            | vars(estimate)
            for name, estimate in self.estimates.items()
        }
        return pd.DataFrame.from_dict(rows, orient="index")

    def __str__(self) -> str:
        lines = [self.task.capitalize()]
        for name, estimate in self.estimates.items():
            metric = METRICS[name]
            head = f"{metric.label} {metric.direction_in(self.task)}"
            lines.append(f"{head:19}  {estimate!s:32}  {metric.unit_in(self.task)}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<TaskResult of {self.task}: {', '.join(self.estimates)}>"

    def _repr_html_(self) -> str:
        return self.to_frame().to_html(border=0)

    def __getattr__(self, name: str) -> Estimate:
        estimates: Mapping[str, Estimate] = self.__dict__.get("estimates", {})
        if name not in estimates:
            raise AttributeError(f"no metric '{name}' here; there are {', '.join(estimates)}")
        return estimates[name]

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.estimates})


@dataclass(frozen=True)
class Gap:
    """A metric on the held-out and on the train shapes, and held-out minus train.

    ``difference`` counts the episodes of both.
    """

    held_out: Estimate
    train: Estimate
    difference: Estimate


@dataclass(frozen=True)
class FamilyResult:
    """A metric on one family's shapes; None for a split without an episode."""

    held_out: Estimate | None
    train: Estimate | None


@dataclass(frozen=True)
class Generalization:
    """What a task's figures are on shapes never trained on, beside those trained on.

    ``gaps`` by metric name; ``families`` by name, each estimating ``family_metric``.
    """

    task: str
    gaps: Mapping[str, Gap]
    family_metric: str
    families: Mapping[str, FamilyResult]


@dataclass(frozen=True)
class Summary:
    """The estimates of a run, task by task.

    ``generalization`` has the tasks that were run on both splits of a shape set.
    """

    tasks: tuple[TaskResult, ...]
    generalization: tuple[Generalization, ...] = ()


def measure(record: PlayedEpisode) -> Episode:
    """Measure one episode; a policy that failed before its first step gives zeros.

    Source: Table 4 and Figures 3 and 9 of the paper; see ``docs/reference/metrics.md``.
    """
    spec = record.spec
    measured = {
        metric.measured_field: metric.measure(record)
        for metric in METRICS.values()
        if metric.measure is not None
    }
    return Episode(
        task=spec.task,
        index=spec.index,
        seed=spec.seed,
        shape=spec.shape,
        family=spec.family,
        split=spec.split,
        outcome=record.outcome,
        start=record.start,
        digest=record.trace.digest(),
        **measured,  # type: ignore[arg-type]  # each measured as its field is typed
    )


def summarize(
    tasks: Sequence[str], episodes: Sequence[Episode], exploration: Sequence[Episode], seed: int
) -> Summary:
    """Estimate every metric of every task from measured episodes: all but the curves.

    ``seed`` is the run's. Each (task, metric) draws from its own stream under it, so an estimate
    does not depend on which other tasks were run. A task without episodes has no estimates.
    """
    root = tuple(int(word) for word in np.random.default_rng(seed).integers(2**32, size=4))
    results = []
    for task in tasks:
        by_role = {
            Role.FINAL: [episode for episode in episodes if episode.task == task],
            Role.EXPLORATION: [episode for episode in exploration if episode.task == task],
        }
        estimates = {}
        for name, metric in METRICS.items():
            if metric.is_in(task):
                found = metric.estimate(by_role[metric.role], stream(root, task, name))
                if found is not None:
                    estimates[name] = found
        ended = Counter(episode.outcome for episode in by_role[Role.FINAL])
        results.append(
            TaskResult(task, estimates, {outcome: ended[outcome] for outcome in Outcome})
        )
    return Summary(tuple(results), generalize(episodes, tasks, root))


def with_curves(summary: Summary, records: Sequence[PlayedEpisode]) -> Summary:
    """Add the curves over time, which only the trajectories of the final policy tell."""
    tasks = []
    for result in summary.tasks:
        traces = [
            one.trace
            for one in records
            if one.spec.role is Role.FINAL and one.spec.task == result.task
        ]
        touch = _by_step([trace.contact_ticks for trace in traces])
        force = _by_step([trace.finger_force() for trace in traces])
        quartiles = (np.percentile(step, (25, 50, 75)).round(3).tolist() for step in force)
        curves = replace(
            result,
            touch_curve=tuple(sum(step) / len(step) for step in touch),
            force_curve=tuple(Quartiles(*step) for step in quartiles),
            curve_episodes=tuple(map(len, touch)),
        )
        tasks.append(curves)
    return replace(summary, tasks=tuple(tasks))


def _by_step(series: Sequence[NDArray[Any]]) -> list[list[float]]:
    """Return by control step the values of the episodes that reached the step."""
    steps = zip_longest(*(values.tolist() for values in series))
    return [[value for value in step if value is not None] for step in steps]


def generalize(
    episodes: Sequence[Episode], tasks: Sequence[str], root: Root
) -> tuple[Generalization, ...]:
    """Compare the splits in each task that has MIN_EPISODES of both, in the order of ``tasks``.

    Source: the paper's generalization study (Figure 11 of its supplement).
    """
    results = []
    for task in tasks:
        by_split = {
            split: [one for one in episodes if one.task == task and one.split == split]
            for split in (Split.HELD_OUT, Split.TRAIN)
        }
        if min(map(len, by_split.values())) >= MIN_EPISODES:
            results.append(_generalize_task(task, by_split, root))
    return tuple(results)


def _generalize_task(
    task: str, by_split: Mapping[Split, Sequence[Episode]], root: Root
) -> Generalization:
    family_metric = METRICS[ranking_metric(task)]

    def of_family(family: str) -> FamilyResult:
        found = (
            family_metric.estimate(
                [episode for episode in members if episode.family == family],
                stream(root, task, family_metric.name, split, family),
            )
            for split, members in by_split.items()
        )
        return FamilyResult(*found)

    families = sorted({episode.family for members in by_split.values() for episode in members})
    return Generalization(
        task=task,
        gaps={
            name: _gap(task, METRICS[name], by_split, root)
            for name in metrics_shown_in(ShownIn.NOVEL_SHAPES, task)
        },
        family_metric=family_metric.name,
        families={family: of_family(family) for family in families},
    )


def _gap(task: str, metric: Metric, by_split: Mapping[Split, Sequence[Episode]], root: Root) -> Gap:
    """Estimate a metric that has a value in every episode, and the difference as independent."""
    first, second = (metric.values(members) for members in by_split.values())
    streams = (stream(root, task, metric.name, part) for part in (*by_split, "gap"))
    return Gap(
        metric.statistic.estimate(first, next(streams)),
        metric.statistic.estimate(second, next(streams)),
        metric.statistic.difference(first, second, next(streams)),
    )


def episode_row(episode: Episode) -> tuple[Any, ...]:
    """Return the cells of an episode: EPISODE_COLUMNS."""
    return (
        *(getattr(episode, name) for name in _IDENTITY),
        *(getattr(episode, metric.column, metric.value(episode)) for metric in _MEASURED),
    )


# Data frames, and what a notebook shows

_BESIDE = ("family", "split", "digest")
_STARTS = (
    *("start_x", "start_y", "start_z", "start_yaw", "target_x", "target_y"),
    *("end_effector_x", "end_effector_y", "end_effector_z"),
)
"""What a frame of episodes has and ``episodes.csv`` has not; see ``episode.Start``."""
OFTEN_MISSING = ("time_to_first_touch", "peak_force", "contact_force")
"""Columns without a value where nothing was touched."""


def episodes_frame(episodes: Iterable[Episode]) -> "pd.DataFrame":
    """Return a row per episode: EPISODE_COLUMNS, family, split, digest, and where it began.

    What an episode does not have, such as the time of its first touch, is NaN.
    """
    import pandas as pd  # noqa: PLC0415  takes half a second

    rows = []
    for episode in episodes:
        start = episode.start
        target = start.target or (None, None)
        places = (*start.position, start.yaw, *target, *start.end_effector)
        beside = (getattr(episode, name) for name in _BESIDE)
        rows.append((*episode_row(episode), *beside, *places))
    frame = pd.DataFrame(rows, columns=[*EPISODE_COLUMNS, *_BESIDE, *_STARTS])
    frame["outcome"] = frame["outcome"].map(str)  # plain words, not members of the enumeration
    numbers = dict.fromkeys((*OFTEN_MISSING, *_STARTS), "float64")
    return frame.astype({"outcome": "str", **numbers})


def table4_frame(summary: Summary) -> "pd.DataFrame":
    """Return Table 4 in the paper's shape: metrics as rows, tasks as groups of columns.

    Each task has the columns ``value``, ``low`` and ``high`` (95 %), NaN without estimate.
    """
    import pandas as pd  # noqa: PLC0415  takes half a second

    frames = {
        task.task: task.to_frame().reindex(index=TABLE4_METRICS, columns=["value", "low", "high"])
        for task in summary.tasks
    }
    return pd.concat(frames, axis="columns").astype(float).rename_axis("metric")


def summary_html(title: str, summary: Summary) -> str:
    """Write what a notebook shows of a run: Table 4, and outcomes below."""
    import pandas as pd  # noqa: PLC0415  takes half a second

    rows = {}
    for metric in (METRICS[name] for name in TABLE4_METRICS):
        found = [task.estimates.get(metric.name) for task in summary.tasks]
        if any(found):
            texts = (f"{one:{metric.number_format}}" if one else "—" for one in found)
            rows[f"{metric.label} {metric.direction}"] = [metric.unit, *texts]
    ended = (
        ", ".join(f"{how.replace('_', ' ')} {n}" for how, n in task.outcomes.items() if n)
        for task in summary.tasks
    )
    rows["Outcomes"] = ["episodes", *ended]
    columns = ["unit", *(task.task for task in summary.tasks)]
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    with pd.option_context("display.max_colwidth", None):  # nothing is cut
        table = frame.to_html(border=0)
    note = "<p><small>Brackets: 95 % interval over episodes.</small></p>"
    return f"<p><b>{html.escape(printable(title))}</b></p>{table}{note}"
