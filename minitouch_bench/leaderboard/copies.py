"""Runs that have episodes of others, bit for bit.

Only equal bits are found: a copy that acts a little otherwise in most of its episodes is not.
"""

from collections import Counter
from collections.abc import Hashable, Iterable, Mapping
from itertools import combinations
from typing import TypeVar

from minitouch_bench.records import SavedRun

Run = TypeVar("Run", bound=Hashable)

SHARE = 0.5
"""Share of episodes in common from which on one run copies another: two trainings have none."""


def episode_digests(run: SavedRun) -> tuple[str, ...]:
    """Return each episode of the final policy as its name and digest."""
    return tuple(f"{row.task}/{row.index} {row.digest}" for row in run.episodes)


def find_copies(runs: Mapping[Run, Iterable[str]]) -> dict[tuple[Run, Run], int]:
    """Return the pairs of runs, in their order, that share episodes, and how many they share.

    They share at least SHARE of the episodes of the smaller one.
    """
    sizes: Counter[Run] = Counter()
    owners: dict[str, list[Run]] = {}
    for run, episodes in runs.items():
        for episode in episodes:
            sizes[run] += 1
            owners.setdefault(episode, []).append(run)
    shared = Counter(pair for found in owners.values() for pair in combinations(found, 2))
    return {
        (one, other): count
        for (one, other), count in shared.items()
        if count >= SHARE * min(sizes[one], sizes[other])
    }
