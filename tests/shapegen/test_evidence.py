from pathlib import Path

import numpy as np

from benchmarks.shape_evidence import (
    TURNS,
    biased_split,
    near_duplicates,
    split_p_value,
    stats_text,
)
from minitouch_bench.shapegen.body_codec import Body
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set
from minitouch_bench.shapegen.mesh import Mesh
from tests.shapegen.bodies import box

FAMILIES = ["a", "b"] * 100


def features() -> np.ndarray:
    """Return 200 random descriptors with the layout of real ones."""
    rng = np.random.default_rng(0)
    return np.concatenate([rng.normal(size=(200, 6)), rng.random((200, 32)).cumsum(axis=1)], axis=1)


def duplicates(*meshes: Mesh) -> list[tuple[int, int, float]]:
    bodies = [Body(mesh, (mesh,), 1.0, (1.0, 1.0, 1.0)) for mesh in meshes]
    return [(pair.first, pair.second, round(pair.iou, 4)) for pair in near_duplicates(bodies)]


def test_a_solid_is_its_own_duplicate_however_it_is_turned() -> None:
    mesh = canonical_shape_set().shapes[3].body().visual
    for turn in TURNS[::7]:
        assert duplicates(mesh, mesh.moved(turn, np.zeros(3))) == [(0, 1, 1.0)]


def test_near_duplicates_are_found_and_others_are_not() -> None:
    sides = [(0.05, 0.04, 0.03), (0.0402, 0.05, 0.03), (0.055, 0.04, 0.03), (0.05, 0.04, 0.0288)]
    assert duplicates(*(box(*side) for side in sides)) == [
        (0, 1, 0.995),
        (0, 3, 0.96),
        (1, 3, 0.9552),
    ]


def test_a_fair_split_passes_and_a_biased_one_fails() -> None:
    descriptors = features()
    fair = biased_split(descriptors[:, 0], FAMILIES, 0.0, np.random.default_rng(1))
    biased = biased_split(descriptors[:, 0], FAMILIES, 1.0, np.random.default_rng(1))
    p_fair = split_p_value(descriptors, fair, FAMILIES, np.random.default_rng(2), 499)
    p_biased = split_p_value(descriptors, biased, FAMILIES, np.random.default_rng(2), 499)
    assert p_fair > 0.05
    assert p_biased < 0.01
    again = split_p_value(descriptors, fair, FAMILIES, np.random.default_rng(2), 499)
    assert again == p_fair


def test_the_statistics_name_every_family_and_the_split(small_set: Path) -> None:
    text = stats_text(load_shape_set(small_set))
    assert "stacked" in text
    assert "the set's split" in text
    assert "biased on purpose: heavier, strength 1.0" in text
