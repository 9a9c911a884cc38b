import numpy as np
import pytest

from minitouch_bench.shapegen.likeness import (
    aligned_iou,
    biased_split,
    descriptor,
    near_duplicates,
    split_p_value,
)
from minitouch_bench.shapegen.poses import rotation_matrix
from tests.shapegen.bodies import box, box_body

FAMILIES = ["a", "b"] * 100


def features() -> np.ndarray:
    """Return 200 random descriptors with the layout of real ones."""
    rng = np.random.default_rng(0)
    return np.concatenate([rng.normal(size=(200, 6)), rng.random((200, 32)).cumsum(axis=1)], axis=1)


def test_a_solid_is_its_own_duplicate_however_it_is_turned() -> None:
    mesh = box(0.05, 0.04, 0.03)
    quarter = rotation_matrix((0.5, 0.5, 0.5, 0.5))
    assert aligned_iou(mesh, mesh.moved(quarter, np.zeros(3))) == pytest.approx(1.0)
    assert aligned_iou(mesh, box(0.05, 0.04, 0.027)) == pytest.approx(0.9)


def test_near_duplicates_are_found_and_others_are_not() -> None:
    sides = [(0.05, 0.04, 0.03), (0.05, 0.0402, 0.03), (0.055, 0.04, 0.03)]
    bodies = [box_body(*side) for side in sides]
    pairs = near_duplicates(bodies, np.array([descriptor(body) for body in bodies]))
    assert [(pair.first, pair.second) for pair in pairs] == [(0, 1)]


def test_the_distance_histogram_is_a_share_of_pairs() -> None:
    found = descriptor(box_body(0.05, 0.04, 0.03))
    assert found[-1] == pytest.approx(1.0)
    assert (np.diff(found[6:]) >= 0).all()


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
