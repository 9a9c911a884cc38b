"""Submissions whose episodes repeat another's, bit for bit or nearly."""

from collections.abc import Iterable, Sequence
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from minitouch_bench.evaluation.actions import Actions
from minitouch_bench.leaderboard.scores import ScoredSubmission
from minitouch_bench.leaderboard.submission import MAIN_SUITE, run_place

Sketch = tuple[float, ...]

STEPS = 8
"""First control steps of each episode that a sketch covers: contact has not parted them yet."""
MOST_NUMBERS = 5
SIZE = 64
"""Numbers in a sketch."""
NEARLY = 0.05
"""Root mean square difference of actions below which one run nearly repeats the other."""


def sketch_of(actions: Sequence[Actions]) -> Sketch:
    """Return a random projection of the first actions of a run's episodes, in their order.

    Its distances are those of the actions, up to a tenth or two (Johnson and Lindenstrauss
    1984): the root mean square over all numbers, those after an episode's end being 0.
    """
    first = np.zeros((len(actions), STEPS, MOST_NUMBERS))
    for row, own in zip(first, actions, strict=True):
        row[: len(own), : own.shape[1]] = own[:STEPS]
    found = _projection(first.size) @ first.ravel()
    return tuple(np.round(found, 6).tolist())


@cache
def _projection(size: int) -> NDArray[np.float64]:
    scale = 1.0 / float(np.sqrt(SIZE * size))
    return np.random.default_rng(0).normal(0.0, scale, (SIZE, size))


def exact_twins(scored: Sequence[ScoredSubmission]) -> dict[str, tuple[str, ...]]:
    """Return by name the others whose episodes of the main suite are the same bits."""
    owners: dict[str, list[str]] = {}
    for one in scored:
        for seed in one.about.seeds:
            owners.setdefault(one.runs[run_place(seed.seed, MAIN_SUITE)], []).append(one.name)
    return _listed(pair for names in owners.values() for pair in product(names, names))


def near_twins(scored: Sequence[ScoredSubmission]) -> dict[str, tuple[str, ...]]:
    """Return by name the others with nearly the same actions, as far as their proofs tell."""
    owned = [(one.name, sketch) for one in scored for sketch in one.sketches.values()]
    if not owned:
        return {}
    pairs = cKDTree([sketch for _, sketch in owned]).query_pairs(NEARLY)
    names = [(owned[first][0], owned[second][0]) for first, second in pairs]
    return _listed([*names, *((second, first) for first, second in names)])


def _listed(pairs: Iterable[tuple[str, str]]) -> dict[str, tuple[str, ...]]:
    found: dict[str, set[str]] = {}
    for one, other in pairs:
        if one != other:
            found.setdefault(one, set()).add(other)
    return {name: tuple(sorted(others)) for name, others in found.items()}
