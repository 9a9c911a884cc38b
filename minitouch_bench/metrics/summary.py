"""The metrics of each episode, and from them the estimates of a run: by task, and by split."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import (
    Episode,
    Estimate,
    FamilyResult,
    Gap,
    Generalization,
    Outcome,
    PlayedEpisode,
    Role,
    Summary,
    TaskSummary,
)
from minitouch_bench.metrics.definitions import (
    METRICS,
    Metric,
    ShownIn,
    metrics_shown_in,
    ranking_metric,
)
from minitouch_bench.metrics.intervals import Root, stream
from minitouch_bench.protocol.spec import Split

GAP_PARTS = {
    "held_out": Split.HELD_OUT.value,
    "train": Split.TRAIN.value,
    "difference": "held-out minus train",
}
"""The fields of a gap, and what each is called behind its metric's name."""

MIN_EPISODES = 10
"""Episodes of each split below which a gap would be noise alone."""


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
        digest=record.trace.digest(),
        **measured,  # type: ignore[arg-type]  # each measured as its field is typed
    )


def summarize(
    tasks: Sequence[str],
    episodes: Sequence[Episode],
    exploration: Sequence[Episode],
    seed: int,
) -> Summary:
    """Estimate every metric of every task from measured episodes: all but the touch curves.

    ``seed`` is the run's. Each (task, metric) draws from its own stream under it, so an estimate
    does not depend on which other tasks were run.
    """
    root = tuple(int(word) for word in np.random.default_rng(seed).integers(2**32, size=4))
    return Summary(
        tasks=tuple(_summarize_task(task, episodes, exploration, root) for task in tasks),
        generalization=generalize(episodes, tasks, root),
    )


def with_touch_curves(summary: Summary, records: Sequence[PlayedEpisode]) -> Summary:
    """Add what only the trajectories tell."""
    final = [record for record in records if record.spec.role is Role.FINAL]
    curves = {task.task: touch_curve(final, task.task) for task in summary.tasks}
    tasks = (
        replace(task, touch_curve=curves[task.task][0], touch_curve_episodes=curves[task.task][1])
        for task in summary.tasks
    )
    return replace(summary, tasks=tuple(tasks))


def _summarize_task(
    task: str,
    episodes: Sequence[Episode],
    exploration: Sequence[Episode],
    root: Root,
) -> TaskSummary:
    """Estimate the metrics of one task; a task without episodes has no estimates."""
    by_role = {
        Role.FINAL: [episode for episode in episodes if episode.task == task],
        Role.EXPLORATION: [episode for episode in exploration if episode.task == task],
    }
    estimates = {
        name: metric.estimate(by_role[metric.role], stream(root, task, name))
        for name, metric in METRICS.items()
        if metric.is_in(task)
    }
    return TaskSummary(
        task=task,
        estimates={name: figure for name, figure in estimates.items() if figure is not None},
        outcomes={o: sum(e.outcome is o for e in by_role[Role.FINAL]) for o in Outcome},
        touch_curve=(),
    )


def touch_curve(
    records: Sequence[PlayedEpisode], task: str
) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """Return the mean contact ticks at each control step, and the episodes that reached it."""
    records = [record for record in records if record.spec.task == task]
    longest = max((len(record.trace.contact_ticks) for record in records), default=0)
    total: NDArray[np.int64] = np.zeros(longest, dtype=np.int64)
    reached: NDArray[np.int64] = np.zeros(longest, dtype=np.int64)
    for record in records:
        ticks = record.trace.contact_ticks
        total[: len(ticks)] += ticks
        reached[: len(ticks)] += 1
    return tuple((total / reached).tolist()), tuple(reached.tolist())


def generalize(
    episodes: Sequence[Episode], tasks: Sequence[str], root: Root
) -> tuple[Generalization, ...]:
    """Compare the splits in each task that has MIN_EPISODES of both, in the order of ``tasks``.

    Source: the paper's generalization study (Figure 11 of its supplement).
    """
    results = (
        _generalize_task(task, [e for e in episodes if e.task == task], root) for task in tasks
    )
    return tuple(result for result in results if result is not None)


def has_both_splits(episodes: Sequence[Episode]) -> bool:
    """Tell whether the episodes are of held-out and of train shapes."""
    return {*Split} <= {episode.split for episode in episodes}


def _generalize_task(task: str, episodes: Sequence[Episode], root: Root) -> Generalization | None:
    """Compare the splits in one task, None where a split has too few episodes."""
    held_out = [episode for episode in episodes if episode.split == Split.HELD_OUT]
    train = [episode for episode in episodes if episode.split == Split.TRAIN]
    if min(len(held_out), len(train)) < MIN_EPISODES:
        return None
    family_metric = METRICS[ranking_metric(task)]
    families = sorted({episode.family for episode in (*held_out, *train)})
    return Generalization(
        task=task,
        gaps={
            name: compare_episodes(task, METRICS[name], held_out, train, root)
            for name in metrics_shown_in(ShownIn.NOVEL_SHAPES, task)
        },
        family_metric=family_metric.name,
        families={
            family: FamilyResult(
                _of_family(held_out, family, family_metric, root),
                _of_family(train, family, family_metric, root),
            )
            for family in families
        },
    )


def compare_episodes(
    task: str,
    metric: Metric,
    held_out: Sequence[Episode],
    train: Sequence[Episode],
    root: Root,
) -> Gap:
    """Estimate a metric in two sets of episodes, and the first less the second as independent.

    The metric has a value in every episode. The names are those of a shape set's splits, for
    which it is made; the episodes can also be of two conditions.
    """
    first = metric.estimate(held_out, stream(root, task, metric.name, Split.HELD_OUT))
    second = metric.estimate(train, stream(root, task, metric.name, Split.TRAIN))
    assert first is not None  # such a metric has a value in every episode
    assert second is not None
    values = metric.values(held_out), metric.values(train)
    rng = stream(root, task, metric.name, "gap")
    return Gap(first, second, metric.statistic.difference(*values, rng))


def _of_family(
    episodes: Sequence[Episode], family: str, metric: Metric, root: Root
) -> Estimate | None:
    """Estimate a metric on the shapes of one family, None where there is no episode."""
    members = [episode for episode in episodes if episode.family == family]
    if not members:
        return None
    first = members[0]
    return metric.estimate(members, stream(root, first.task, metric.name, first.split, family))
