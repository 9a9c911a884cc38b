"""What a policy's figures are on held-out shapes, beside those on train shapes."""

from collections.abc import Sequence

from minitouch_bench.metrics.definitions import METRICS, metrics_shown_in, ranking_metric
from minitouch_bench.metrics.intervals import Root, bootstrap_difference, newcombe, stream
from minitouch_bench.metrics.metric import Kind, Metric, ShownIn
from minitouch_bench.records import EpisodeMetrics, Estimate, FamilyResult, Gap, Generalization

HELD_OUT, TRAIN = "held-out", "train"

MIN_EPISODES = 10
"""Episodes of each split below which a gap would be noise alone."""


def generalize(
    episodes: Sequence[EpisodeMetrics], tasks: Sequence[str], root: Root
) -> tuple[Generalization, ...]:
    """Compare the splits in each task that has MIN_EPISODES of both, in the order of ``tasks``.

    Source: the paper's generalisation study (Figure 11 of its supplement).
    """
    found = (
        _generalize_task(task, [e for e in episodes if e.task == task], root) for task in tasks
    )
    return tuple(result for result in found if result is not None)


def has_both_splits(episodes: Sequence[EpisodeMetrics]) -> bool:
    """Tell whether the episodes are of held-out and of train shapes."""
    return {HELD_OUT, TRAIN} <= {episode.split for episode in episodes}


def _generalize_task(
    task: str, episodes: Sequence[EpisodeMetrics], root: Root
) -> Generalization | None:
    """Compare the splits in one task, None where a split has too few episodes."""
    held_out = [episode for episode in episodes if episode.split == HELD_OUT]
    train = [episode for episode in episodes if episode.split == TRAIN]
    if min(len(held_out), len(train)) < MIN_EPISODES:
        return None
    family_metric = METRICS[ranking_metric(task)]
    families = sorted({episode.family for episode in (*held_out, *train)})
    return Generalization(
        task=task,
        gaps={
            name: _gap(task, METRICS[name], held_out, train, root)
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


def _gap(
    task: str,
    metric: Metric,
    held_out: Sequence[EpisodeMetrics],
    train: Sequence[EpisodeMetrics],
    root: Root,
) -> Gap:
    """Estimate a metric on each split, and the difference."""
    one = metric.estimate(held_out, stream(root, task, metric.name, HELD_OUT))
    other = metric.estimate(train, stream(root, task, metric.name, TRAIN))
    assert one is not None  # such a metric has a value in every episode
    assert other is not None
    if metric.kind is Kind.SHARE:
        return Gap(one, other, newcombe(one, other))
    rng = stream(root, task, metric.name, "gap")
    difference = bootstrap_difference(metric.values(held_out), metric.values(train), rng)
    return Gap(one, other, difference)


def _of_family(
    episodes: Sequence[EpisodeMetrics], family: str, metric: Metric, root: Root
) -> Estimate | None:
    """Estimate a metric on the shapes of one family, None where there is no episode."""
    own = [episode for episode in episodes if episode.family == family]
    if not own:
        return None
    return metric.estimate(own, stream(root, own[0].task, metric.name, own[0].split, family))
