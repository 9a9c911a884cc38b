from dataclasses import replace
from itertools import product

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

MESH, BODY = box(*BLOCK), box_body(*BLOCK)
CUBE = Solid.cube([0.02, 0.02, 0.02], True)
LONGER = replace(BODY, hulls=(box(0.083, 0.046, 0.044),))
PYRAMID = hull_of(np.array([*product((-0.025, 0.025), (-0.025, 0.025), [-0.02]), (0, 0, 0.037)]))


def test_a_block_is_sound_and_lies_where_it_is_high_enough():
    """It lies likeliest on its largest side, which is not high enough."""
    measures = check_body(BODY)
    assert len(measures["poses"]) == 6
    assert measures["convexity"] == pytest.approx(1.0)
    assert measures["misfit"] == pytest.approx(0.0, abs=1e-9)
    assert measures["lifted"] == 1.0
    assert measures["wall_m"] == pytest.approx(0.044)
    # The collision margin of 1 mm lifts what rests.
    assert measures["poses"][0].height == pytest.approx(0.041, abs=5e-4)
    hull = hull_of(MESH.vertices)
    assert height_and_width(hull, rest_poses(hull)[0])[0] == pytest.approx(0.044)
    chosen = (0.08, np.hypot(0.046, 0.044))
    assert height_and_width(hull, measures["poses"][0]) == pytest.approx(chosen, abs=5e-4)


@pytest.mark.parametrize(
    ("reason", "check", "wrong"),
    [
        (Reason.NOT_CLOSED, check_mesh, Mesh(MESH.vertices, MESH.faces[1:])),
        (Reason.SEVERAL_BODIES, check_mesh, to_mesh(CUBE + CUBE.translate([0.04, 0.0, 0.0]))),
        (Reason.SIZE, check_mesh, box(0.03, 0.03, 0.03)),
        (Reason.SIZE, check_mesh, box(0.1, 0.03, 0.03)),
        (Reason.THIN_WALL, check_mesh, box(0.06, 0.03, 0.001)),
        (Reason.FACES, check_mesh, to_mesh(Solid.sphere(0.03, 60))),
        (Reason.MASS, check_numbers, replace(BODY, mass=1.1)),
        (Reason.NOT_FINITE, check_numbers, replace(BODY, mass=float("nan"))),
        (Reason.INERTIA, check_numbers, replace(BODY, inertia=(1.0, 1.0, 0.0))),
        (Reason.INERTIA, check_numbers, replace(BODY, inertia=(1.0, 1.0, 3.0))),
        (Reason.MISFIT, check_hulls, replace(BODY, hulls=(box(0.095, 0.046, 0.044),))),
        (Reason.TOO_FLAT, check_body, box_body(0.053, 0.05, 0.045, density=12_000)),
        (Reason.TOO_WIDE, check_body, box_body(0.07, 0.07, 0.058, density=5000)),
        (Reason.SLIPS, check_body, Body(PYRAMID, (PYRAMID,), 1.5, (4e-4, 4e-4, 4e-4))),
    ],
)
def test_what_is_unsound_is_refused_with_the_reason(reason, check, wrong):
    with pytest.raises(UnsoundError) as caught:
        check(wrong)
    assert caught.value.reason is reason


def test_hulls_may_not_stand_out_from_the_mesh(monkeypatch):
    assert check_hulls(BODY) == (pytest.approx(0.0, abs=1e-9), 0.0)
    assert check_hulls(LONGER)[1] == pytest.approx(0.0015, rel=0.1)
    monkeypatch.setattr(soundness, "LIMITS", replace(LIMITS, outside=0.001))
    with pytest.raises(UnsoundError, match=Reason.OUTSIDE):
        check_hulls(LONGER)


def test_a_size_is_chosen_by_the_width_in_that_pose():
    factor = grip_scale(MESH, 0.0755)
    assert factor == pytest.approx(0.0755 / np.hypot(0.046, 0.044), abs=1e-4)
    with pytest.raises(UnsoundError, match=Reason.TOO_FLAT):
        grip_scale(box(0.06, 0.06, 0.005), 0.07)
