import numpy as np
import pytest

from minitouch_bench.shapegen.geometry import (
    distances_to_surface,
    in_body_frame,
    principal_axes,
    rest_poses,
    solid_moments,
)
from minitouch_bench.shapegen.solids import hull_of
from tests.shapegen.bodies import box


def test_moments_of_a_box_are_the_formula():
    mesh = box(0.04, 0.05, 0.06).moved(np.eye(3), np.array([0.1, -0.2, 0.3]))
    moments = solid_moments(mesh)
    assert moments.volume == pytest.approx(1.2e-4)
    assert moments.centroid == pytest.approx([0.1, -0.2, 0.3])
    expected = 1.2e-4 / 12 * np.diag([0.05**2 + 0.06**2, 0.04**2 + 0.06**2, 0.04**2 + 0.05**2])
    assert moments.inertia == pytest.approx(expected, abs=1e-15)


def test_distances_inside_outside_and_past_an_edge():
    points = np.array([[0.0, 0.0, 0.03], [0.0, 0.0, 0.015], [0.023, 0.024, 0.0]])
    found = distances_to_surface(points, box(0.04, 0.04, 0.04))
    assert found == pytest.approx([0.01, 0.005, 0.005])


def test_body_frame_makes_inertia_diagonal_and_keeps_a_cube_as_it_is():
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    moved = in_body_frame(box(0.04, 0.05, 0.06).moved(turn, np.ones(3)))
    assert moved.extents == pytest.approx([0.06, 0.05, 0.04])
    inertia = solid_moments(moved).inertia
    assert np.abs(inertia - np.diag(np.diag(inertia))).max() < 1e-15
    assert principal_axes(np.eye(3)) == pytest.approx(np.eye(3))


def test_a_box_rests_on_each_side_and_most_often_on_the_largest():
    mesh = box(0.02, 0.04, 0.06)
    poses = rest_poses(mesh, least=0.0001)
    assert sum(pose.probability for pose in poses) == pytest.approx(1.0)
    assert poses[0].height == pytest.approx(0.01)
    assert {round(pose.height, 4) for pose in poses} == {0.01, 0.02, 0.03}
    for pose in poses:
        placed = mesh.vertices @ pose.rotation.T
        assert placed[:, 2].min() == pytest.approx(-pose.height)


def test_a_body_rolls_off_a_face_its_centre_is_not_above():
    # An oblique prism, its center of mass set where only the long sides carry it.
    points = np.array([[x + z, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-3, 3)]) * 0.01
    poses = rest_poses(hull_of(points), least=1e-6)
    assert max(abs(pose.rotation[2, 2]) for pose in poses) < 0.99
