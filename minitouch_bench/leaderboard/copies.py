"""Runs that have episodes of others, bit for bit.

Only equal bits are found: a copy that acts a little otherwise in most of its episodes is not.
"""

from collections import Counter
from collections.abc import Hashable, Mapping
from itertools import combinations
from typing import TypeVar

from minitouch_bench.runs.run import Run

Key = TypeVar("Key", bound=Hashable)

SHARE = 0.5
"""Share of episodes in common from which on one run copies another: two trainings have none."""


def find_copies(runs: Mapping[Key, Run]) -> dict[tuple[Key, Key], int]:
    """Return the pairs of runs, in their order, that share episodes, and how many they share.

    They share at least SHARE of the final policy's episodes of the smaller one.
    """
    owners: dict[tuple[str, int, str], list[Key]] = {}
    for key, run in runs.items():
        for row in run.episodes:
            owners.setdefault((row.task, row.index, row.digest), []).append(key)
    shared = Counter(pair for keys in owners.values() for pair in combinations(keys, 2))
    return {
        (first, other): count
        for (first, other), count in shared.items()
        if count >= SHARE * min(len(runs[first].episodes), len(runs[other].episodes))
    }
