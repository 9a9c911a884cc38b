import numpy as np
import pytest

from minitouch_bench.shapegen.geometry import (
    product,
    rest_poses,
    rotation_matrix,
    surface_points,
    yaw,
)
from minitouch_bench.shapegen.grips import plan_grasp
from minitouch_bench.shapegen.solids import hull_of
from tests.shapegen.bodies import box


def test_a_box_rests_on_each_side_and_most_often_on_the_largest() -> None:
    poses = rest_poses(box(0.02, 0.04, 0.06), least=0.0001)
    assert sum(pose.probability for pose in poses) == pytest.approx(1.0)
    assert poses[0].height == pytest.approx(0.01)
    assert {round(pose.height, 4) for pose in poses} == {0.01, 0.02, 0.03}


def test_a_pose_turns_its_face_down() -> None:
    mesh = box(0.02, 0.04, 0.06)
    for pose in rest_poses(mesh):
        placed = mesh.vertices @ pose.rotation.T
        assert placed[:, 2].min() == pytest.approx(-pose.height)


def test_a_body_rolls_off_a_face_its_centre_is_not_above() -> None:
    # An oblique prism, its center of mass set where only the long sides carry it.
    points = np.array([[x + z, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-3, 3)]) * 0.01
    poses = rest_poses(hull_of(points), least=1e-6)
    down = [pose.rotation[2] @ np.array([0.0, 0.0, 1.0]) for pose in poses]
    assert max(np.abs(down)) < 0.99


def test_quaternions_compose_as_matrices() -> None:
    first, second = yaw(0.3), (0.5, 0.5, 0.5, 0.5)
    both = rotation_matrix(product(first, second))
    assert both == pytest.approx(rotation_matrix(first) @ rotation_matrix(second))


def test_a_bar_is_gripped_across() -> None:
    cloud = surface_points(box(0.06, 0.02, 0.03), 0.003) + np.array([0.0, 0.0, 0.015])
    grasp = plan_grasp(cloud)
    assert grasp.width == pytest.approx(0.02, abs=1e-3)
    assert abs(grasp.x) < 0.004
    assert abs(grasp.y) < 1e-3


def test_nothing_fits_round_a_slab() -> None:
    cloud = surface_points(box(0.09, 0.09, 0.03), 0.003) + np.array([0.0, 0.0, 0.015])
    assert plan_grasp(cloud).width == np.inf
