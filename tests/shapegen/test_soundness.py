from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.shapegen import soundness
from minitouch_bench.shapegen.body_codec import Body
from minitouch_bench.shapegen.geometry import Mesh, rest_poses
from minitouch_bench.shapegen.solids import Solid, hull_of, to_mesh
from minitouch_bench.shapegen.soundness import (
    LIMITS,
    Reason,
    UnsoundError,
    check_body,
    check_hulls,
    check_mesh,
    check_numbers,
    grip_scale,
    height_and_width,
    laid_pose,
)
from tests.shapegen.bodies import BLOCK, box, box_body


def reason_of(check: object, *arguments: object) -> Reason:
    with pytest.raises(UnsoundError) as caught:
        check(*arguments)  # type: ignore[operator]
    return caught.value.reason


def test_a_plain_block_is_sound() -> None:
    measures = check_body(box_body(*BLOCK))
    assert len(measures["poses"]) == 6
    assert measures["convexity"] == pytest.approx(1.0)
    assert measures["misfit"] == pytest.approx(0.0, abs=1e-9)
    assert measures["lifted"] == 1.0
    # The collision margin of 1 mm lifts what rests.
    assert measures["poses"][0].height == pytest.approx(0.041, abs=5e-4)


def test_a_mesh_is_finite_closed_and_one_body() -> None:
    mesh = box(*BLOCK)
    vertices = mesh.vertices.copy()
    vertices[3, 1] = np.nan
    assert reason_of(check_mesh, Mesh(vertices, mesh.faces)) is Reason.NOT_FINITE
    assert reason_of(check_mesh, Mesh(mesh.vertices, mesh.faces[1:])) is Reason.NOT_CLOSED
    cube = Solid.cube([0.02, 0.02, 0.02], True)
    pair = cube + cube.translate([0.04, 0.0, 0.0])
    assert reason_of(check_mesh, to_mesh(pair)) is Reason.SEVERAL_BODIES


def test_sizes_walls_and_faces() -> None:
    assert reason_of(check_mesh, box(0.03, 0.03, 0.03)) is Reason.SIZE
    assert reason_of(check_mesh, box(0.1, 0.03, 0.03)) is Reason.SIZE
    assert reason_of(check_mesh, box(0.06, 0.03, 0.001)) is Reason.THIN_WALL
    assert reason_of(check_mesh, to_mesh(Solid.sphere(0.03, 60))) is Reason.FACES


def test_masses_and_moments() -> None:
    body = box_body(*BLOCK)
    assert reason_of(check_numbers, replace(body, mass=1.1)) is Reason.MASS
    assert reason_of(check_numbers, replace(body, mass=float("nan"))) is Reason.NOT_FINITE
    assert reason_of(check_numbers, replace(body, inertia=(1.0, 1.0, 0.0))) is Reason.INERTIA
    assert reason_of(check_numbers, replace(body, inertia=(1.0, 1.0, 3.0))) is Reason.INERTIA


def test_hulls_must_follow_the_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    body = box_body(*BLOCK)
    larger = box(0.083, 0.046, 0.044)
    assert check_hulls(body) == (pytest.approx(0.0, abs=1e-9), 0.0)
    fat = Body(body.visual, (box(0.095, 0.046, 0.044),), body.mass, body.inertia)
    assert reason_of(check_hulls, fat) is Reason.MISFIT
    monkeypatch.setattr(soundness, "LIMITS", replace(LIMITS, outside=0.001))
    with pytest.raises(UnsoundError, match="stands out"):
        check_hulls(Body(body.visual, (larger,), body.mass, body.inertia))


def test_flat_and_wide() -> None:
    assert reason_of(check_body, box_body(0.053, 0.05, 0.045, density=12_000)) is Reason.TOO_FLAT
    assert reason_of(check_body, box_body(0.07, 0.07, 0.058, density=5000)) is Reason.TOO_WIDE


def test_the_first_pose_is_the_one_that_the_tasks_lay_it_down_in() -> None:
    """A block lies likeliest on its largest side, which is not high enough."""
    hull = hull_of(box(*BLOCK).vertices)
    poses = rest_poses(hull)
    boxes = [height_and_width(hull, pose) for pose in poses]
    assert boxes[0][0] == pytest.approx(0.044)
    chosen = boxes[laid_pose(hull, poses)]
    assert chosen == pytest.approx((0.08, np.hypot(0.046, 0.044)), abs=1e-5)
    assert height_and_width(hull, check_body(box_body(*BLOCK))["poses"][0]) == pytest.approx(
        chosen, abs=5e-4
    )


def test_a_size_is_chosen_by_the_width_in_that_pose() -> None:
    mesh = box(*BLOCK)
    factor = grip_scale(mesh, 0.0755)
    assert factor == pytest.approx(0.0755 / np.hypot(0.046, 0.044), abs=1e-4)
    assert reason_of(grip_scale, box(0.06, 0.06, 0.005), 0.07) is Reason.TOO_FLAT


def test_what_slips_from_the_fingers_is_refused() -> None:
    pyramid = Solid.hull_points(
        np.array(
            [[x, y, -0.02] for x in (-0.025, 0.025) for y in (-0.025, 0.025)] + [[0, 0, 0.037]]
        )
    )
    mesh = to_mesh(pyramid)
    body = Body(mesh, (mesh,), 1.5, (4e-4, 4e-4, 4e-4))
    assert reason_of(check_body, body) is Reason.SLIPS
