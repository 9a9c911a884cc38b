"""Submissions whose episodes repeat another's, bit for bit or nearly."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from minitouch_bench.evaluation.actions import Actions

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


def exact_twins(digests: Mapping[str, Iterable[str]]) -> dict[str, tuple[str, ...]]:
    """Return by name the others with a run of the same digest."""
    owners: dict[str, list[str]] = {}
    for name, own in digests.items():
        for digest in own:
            owners.setdefault(digest, []).append(name)
    return _listed(pair for names in owners.values() for pair in product(names, names))


def near_twins(sketches: Mapping[str, Iterable[Sketch]]) -> dict[str, tuple[str, ...]]:
    """Return by name the others with nearly the same actions, as far as sketches tell."""
    owned = [(name, sketch) for name, own in sketches.items() for sketch in own]
    if not owned:
        return {}
    pairs = cKDTree([sketch for _, sketch in owned]).query_pairs(NEARLY)
    return _listed(
        pair for one, other in pairs for pair in permutations((owned[one][0], owned[other][0]))
    )


def _listed(pairs: Iterable[tuple[str, str]]) -> dict[str, tuple[str, ...]]:
    found: dict[str, set[str]] = {}
    for one, other in pairs:
        if one != other:
            found.setdefault(one, set()).add(other)
    return {name: tuple(sorted(others)) for name, others in found.items()}
