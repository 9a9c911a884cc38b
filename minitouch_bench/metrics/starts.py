"""Whether success depends on where an episode begins: one permutation test over all bins."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Episode
from minitouch_bench.metrics.intervals import Floats, stream
from minitouch_bench.metrics.statistics import ALPHA, holm
from minitouch_bench.protocol.minitouch import OPENING
from minitouch_bench.text import printable

PERMUTATIONS = 999
"""A p-value is at least 1 / 1,000, which 50 tests at 5 % together still resolve."""

HANDLE = OPENING.cabinet.hinge_y + OPENING.cabinet.handle_radius
"""How far to the left of the cabinet's middle the handle is, m."""

FEWEST_SCENES = 5
"""Scenes that a bin has, and leaves to the rest, or it is not tested."""

DISTANCES, SECTORS, THIRDS = 4, 8, 3

DIRECTIONS = (
    "beyond", "beyond and left of", "left of", "in front of and left of",
    "in front of", "in front of and right of", "right of", "beyond and right of",
)  # fmt: skip
"""Where an object lies, seen from the robot, counterclockwise from straight ahead (x)."""


Members = NDArray[np.bool_]
"""Which scenes belong to a bin, bool (N,)."""


@dataclass(frozen=True)
class StartTest:
    """What the test says of one policy, or the trainings of one method, in one task.

    ``bins``: how many were tested; without any, ``p_value`` is 1. ``where`` names the bin that
    differs most from the rest, ``inside`` and ``outside`` count successes and episodes.
    """

    episodes: int
    scenes: int
    successes: int
    bins: int = 0
    p_value: float = 1.0
    where: str = ""
    inside: tuple[int, int] = (0, 0)
    outside: tuple[int, int] = (0, 0)

    @property
    def is_found(self) -> bool:
        """Whether success depends on the start."""
        return self.p_value <= ALPHA


def judge_starts(groups: Sequence[tuple[str, Sequence[Episode]]]) -> tuple[StartTest, ...]:
    """Test each group, a task with its episodes; the p-values are adjusted over all by Holm.

    Scenes are exchanged, not episodes: several trainings play the same scenes. The statistic is
    the largest difference between the mean success in a bin and in the rest, in standard errors,
    so one test covers all bins. A group that has nothing to test is not one of the family: whether
    it has depends on the number of successes alone, which the permutations keep.

    Source: P. H. Westfall and S. S. Young, "Resampling-based multiple testing" (1993), of the
    largest statistic.
    """
    tests = [_test_group(task, episodes) for task, episodes in groups]
    tried = [index for index, test in enumerate(tests) if test.bins]
    for index, p_value in zip(tried, holm([tests[i].p_value for i in tried]), strict=True):
        tests[index] = replace(tests[index], p_value=p_value)
    return tuple(tests)


def _test_group(task: str, episodes: Sequence[Episode]) -> StartTest:
    by_scene: dict[tuple[int, str], list[Episode]] = {}
    for episode in episodes:
        by_scene.setdefault((episode.seed, episode.shape), []).append(episode)
    won = np.array([sum(one.success for one in group) for group in by_scene.values()], np.int64)
    played = np.array([len(group) for group in by_scene.values()], np.int64)
    untested = StartTest(len(episodes), len(by_scene), int(won.sum()))
    success = won / played
    if len(by_scene) < 2 * FEWEST_SCENES or np.ptp(success) == 0.0:
        return untested
    bins = [
        (words, members)
        for words, members in start_bins(task, [group[0] for group in by_scene.values()])
        if FEWEST_SCENES <= members.sum() <= len(by_scene) - FEWEST_SCENES
    ]
    if not bins:
        return untested
    members = np.array([chosen for _, chosen in bins], np.float64)
    observed = _differences(success[None], members)[0]
    # Each group draws its own permutations: shared ones would give all groups the same error.
    rng = stream((), task, "starts", success.tobytes().hex())
    permuted = rng.permuted(np.tile(success, (PERMUTATIONS, 1)), axis=1)
    as_large = _differences(permuted, members).max(axis=1) >= observed.max() - 1e-9
    where, chosen = bins[int(observed.argmax())]
    return replace(
        untested,
        bins=len(bins),
        p_value=(1 + int(as_large.sum())) / (1 + PERMUTATIONS),
        where=where,
        inside=(int(won[chosen].sum()), int(played[chosen].sum())),
        outside=(int(won[~chosen].sum()), int(played[~chosen].sum())),
    )


def _differences(values: Floats, members: Floats) -> Floats:
    """Return how far each bin's mean is from the rest's, (B, bins), in units of one deviation.

    Of values float64 (B, N) and bins float64 (bins, N). With n of N scenes in a bin, its sum has
    the variance s² n (N - n) / N under permutation, whose s² is the same for all bins.
    """
    count, inside = members.shape[1], members.sum(axis=1)
    excess = values @ members.T - values.mean(axis=1, keepdims=True) * inside
    differences: Floats = np.abs(excess) / np.sqrt(inside * (count - inside) / count)
    return differences


# Bins


def start_bins(task: str, scenes: Sequence[Episode]) -> Iterator[tuple[str, Members]]:
    """Yield the bins of a task: of its distances, directions, yaws, and families of shapes.

    A bin has words, which complete "where ...", and its members.

    Distance and direction are the object's from its target, otherwise from the end effector.
    """
    starts = [scene.start for scene in scenes]
    places = np.array([start.position[:2] for start in starts]).reshape(-1, 2)
    if task == OPENING.name:
        yield from _parts(places[:, 1] + HANDLE, THIRDS, _beside_the_robot)
        return
    has_target = all(start.target for start in starts)
    origins = [start.target or start.end_effector[:2] for start in starts]
    away = places - np.array(origins).reshape(-1, 2)
    other = "its target" if has_target else "the hand"
    apart = f"the object lies {{:.1f}} to {{:.1f}} cm from {other}".format
    yield from _parts(np.hypot(*away.T), DISTANCES, apart)
    ahead = np.round(np.arctan2(away[:, 1], away[:, 0]) / (2 * math.pi) * SECTORS) % SECTORS
    for sector, words in enumerate(DIRECTIONS):
        yield f"the object lies {words} {other}", ahead == sector
    yaws = np.degrees([start.yaw for start in starts]) % 360
    width = 360 // SECTORS
    for low in range(0, 360, width) if np.ptp(yaws) > 0 else ():
        words = f"the object is turned by {low} to {low + width}°"
        yield words, (yaws >= low) & (yaws < low + width)
    families = np.array([scene.family for scene in scenes])
    for family in sorted(set(families.tolist())):
        yield f"the shape is of the family {printable(family)}", families == family


def _beside_the_robot(low: float, high: float) -> str:
    """Say where the handle is, from its least and its greatest distance to the left, in cm."""
    if low >= 0:
        return f"the handle is {low:.1f} to {high:.1f} cm left of the robot"
    if high <= 0:
        return f"the handle is {-high:.1f} to {-low:.1f} cm right of the robot"
    return f"the handle is between {-low:.1f} cm right and {high:.1f} cm left of the robot"


def _parts(
    values: Floats, number: int, words: Callable[[float, float], str]
) -> Iterator[tuple[str, Members]]:
    """Yield bins of about equally many scenes; ``words`` takes their ends, in cm of m."""
    edges = np.quantile(values, np.linspace(0, 1, number + 1))
    part = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, number - 1)
    for index, (low, high) in enumerate(pairwise(edges)):
        yield words(100 * low, 100 * high), part == index
