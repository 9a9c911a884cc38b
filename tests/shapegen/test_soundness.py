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
)
from tests.shapegen.bodies import BLOCK, box, box_body


def reason_of(check: object, *arguments: object) -> Reason:
    with pytest.raises(UnsoundError) as caught:
        check(*arguments)  # type: ignore[operator]
    return caught.value.reason


def test_a_block_is_sound_and_lies_where_it_is_high_enough() -> None:
    """It lies likeliest on its largest side, which is not high enough."""
    measures = check_body(box_body(*BLOCK))
    assert len(measures["poses"]) == 6
    assert measures["convexity"] == pytest.approx(1.0)
    assert measures["misfit"] == pytest.approx(0.0, abs=1e-9)
    assert measures["lifted"] == 1.0
    # The collision margin of 1 mm lifts what rests.
    assert measures["poses"][0].height == pytest.approx(0.041, abs=5e-4)
    hull = hull_of(box(*BLOCK).vertices)
    assert height_and_width(hull, rest_poses(hull)[0])[0] == pytest.approx(0.044)
    chosen = (0.08, np.hypot(0.046, 0.044))
    assert height_and_width(hull, measures["poses"][0]) == pytest.approx(chosen, abs=5e-4)


def test_a_mesh_is_closed_and_one_body_of_bounded_size() -> None:
    mesh = box(*BLOCK)
    cube = Solid.cube([0.02, 0.02, 0.02], True)
    for reason, wrong in (
        (Reason.NOT_CLOSED, Mesh(mesh.vertices, mesh.faces[1:])),
        (Reason.SEVERAL_BODIES, to_mesh(cube + cube.translate([0.04, 0.0, 0.0]))),
        (Reason.SIZE, box(0.03, 0.03, 0.03)),
        (Reason.SIZE, box(0.1, 0.03, 0.03)),
        (Reason.THIN_WALL, box(0.06, 0.03, 0.001)),
        (Reason.FACES, to_mesh(Solid.sphere(0.03, 60))),
    ):
        assert reason_of(check_mesh, wrong) is reason


def test_masses_and_moments() -> None:
    body = box_body(*BLOCK)
    assert reason_of(check_numbers, replace(body, mass=1.1)) is Reason.MASS
    assert reason_of(check_numbers, replace(body, mass=float("nan"))) is Reason.NOT_FINITE
    for moments in ((1.0, 1.0, 0.0), (1.0, 1.0, 3.0)):
        assert reason_of(check_numbers, replace(body, inertia=moments)) is Reason.INERTIA


def test_hulls_must_follow_the_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    body = box_body(*BLOCK)
    assert check_hulls(body) == (pytest.approx(0.0, abs=1e-9), 0.0)
    fat = replace(body, hulls=(box(0.095, 0.046, 0.044),))
    assert reason_of(check_hulls, fat) is Reason.MISFIT
    monkeypatch.setattr(soundness, "LIMITS", replace(LIMITS, outside=0.001))
    longer = replace(body, hulls=(box(0.083, 0.046, 0.044),))
    assert reason_of(check_hulls, longer) is Reason.OUTSIDE


def test_flat_and_wide() -> None:
    assert reason_of(check_body, box_body(0.053, 0.05, 0.045, density=12_000)) is Reason.TOO_FLAT
    assert reason_of(check_body, box_body(0.07, 0.07, 0.058, density=5000)) is Reason.TOO_WIDE


def test_a_size_is_chosen_by_the_width_in_that_pose() -> None:
    mesh = box(*BLOCK)
    factor = grip_scale(mesh, 0.0755)
    assert factor == pytest.approx(0.0755 / np.hypot(0.046, 0.044), abs=1e-4)
    assert reason_of(grip_scale, box(0.06, 0.06, 0.005), 0.07) is Reason.TOO_FLAT


def test_what_slips_from_the_fingers_is_refused() -> None:
    corners = [[x, y, -0.02] for x in (-0.025, 0.025) for y in (-0.025, 0.025)]
    mesh = hull_of(np.array([*corners, [0.0, 0.0, 0.037]]))
    body = Body(mesh, (mesh,), 1.5, (4e-4, 4e-4, 4e-4))
    assert reason_of(check_body, body) is Reason.SLIPS
