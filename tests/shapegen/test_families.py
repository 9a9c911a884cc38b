import json

import numpy as np
import pytest

from minitouch_bench.processes import run_in_workers
from minitouch_bench.shapegen.families import FAMILIES
from minitouch_bench.shapegen.generate import make_shape
from minitouch_bench.shapegen.solids import to_mesh
from tests.shapegen.conftest import entry_of


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_is_a_pure_function_of_its_generator(name):
    first, same, other = (
        to_mesh(FAMILIES[name](np.random.default_rng(seed))).vertices for seed in (5, 5, 6)
    )
    assert np.array_equal(first, same)
    assert not np.array_equal(first, other)


def made_again(indices):
    """Make shapes in workers, whose arithmetic is the same on every processor."""
    made = dict(run_in_workers(make_shape, [(0, i) for i in indices], workers=2, name=str))
    return [json.loads(json.dumps(made[place][0])) for place in range(len(indices))]


def test_a_shape_made_again_is_the_committed_one_with_all_its_measures():
    quick = min(range(64), key=lambda i: (entry_of(i)["attempt"], entry_of(i)["hulls"]))
    assert made_again([quick]) == [entry_of(quick)]


@pytest.mark.slow
def test_fifty_shapes_made_again_are_the_committed_ones():
    chosen = np.random.default_rng(1).choice(1000, size=50, replace=False).tolist()
    assert made_again(chosen) == [entry_of(index) for index in chosen]
