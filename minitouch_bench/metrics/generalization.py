"""What a policy's figures are on held-out shapes, beside those on train shapes."""

from collections.abc import Sequence

import numpy as np

from minitouch_bench.metrics.intervals import (
    bootstrap_difference,
    bootstrap_mean,
    newcombe,
    wilson,
)
from minitouch_bench.metrics.streams import Root, stream
from minitouch_bench.records import (
    GOAL_TASKS,
    EpisodeMetrics,
    Estimate,
    FamilyResult,
    Gap,
    Generalization,
)

HELD_OUT, TRAIN = "held-out", "train"

MIN_EPISODES = 10
"""Episodes of each split below which a gap would be noise alone."""

GOAL_METRICS = ("success", "episode_steps", "touch_interaction", "object_movement")
TOUCH_METRICS = ("touch_interaction", "object_movement")
"""Playing has no goal."""

_ATTRIBUTES = {"episode_steps": "steps"}


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
    metrics = GOAL_METRICS if task in GOAL_TASKS else TOUCH_METRICS
    families = sorted({episode.family for episode in (*held_out, *train)})
    return Generalization(
        task=task,
        gaps={metric: _gap(task, metric, held_out, train, root) for metric in metrics},
        family_metric=metrics[0],
        families={
            family: FamilyResult(
                _of_family(held_out, family, metrics[0], root),
                _of_family(train, family, metrics[0], root),
            )
            for family in families
        },
    )


def _gap(
    task: str,
    metric: str,
    held_out: Sequence[EpisodeMetrics],
    train: Sequence[EpisodeMetrics],
    root: Root,
) -> Gap:
    """Estimate a metric on each split, and the difference."""
    one = _estimate(held_out, metric, stream(root, task, metric, HELD_OUT))
    other = _estimate(train, metric, stream(root, task, metric, TRAIN))
    if metric == "success":
        return Gap(one, other, newcombe(one, other))
    rng = stream(root, task, metric, "gap")
    return Gap(
        one, other, bootstrap_difference(_values(held_out, metric), _values(train, metric), rng)
    )


def _of_family(
    episodes: Sequence[EpisodeMetrics], family: str, metric: str, root: Root
) -> Estimate | None:
    """Estimate a metric on the shapes of one family, None where there is no episode."""
    own = [episode for episode in episodes if episode.family == family]
    if not own:
        return None
    return _estimate(own, metric, stream(root, own[0].task, metric, own[0].split, family))


def _estimate(
    episodes: Sequence[EpisodeMetrics], metric: str, rng: np.random.Generator
) -> Estimate:
    """Estimate one metric of some episodes."""
    if metric == "success":
        return wilson(sum(episode.success for episode in episodes), len(episodes))
    return bootstrap_mean(_values(episodes, metric), rng)


def _values(episodes: Sequence[EpisodeMetrics], metric: str) -> list[float]:
    """Return a metric's values, one an episode."""
    return [float(getattr(episode, _ATTRIBUTES.get(metric, metric))) for episode in episodes]
