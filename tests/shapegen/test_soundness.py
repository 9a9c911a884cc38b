from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.shapegen.mesh import Mesh
from minitouch_bench.shapegen.record import Body
from minitouch_bench.shapegen.solids import Solid, to_mesh
from minitouch_bench.shapegen.soundness import (
    Reason,
    SoundnessConfig,
    UnsoundError,
    check_hulls,
    check_mesh,
    check_numbers,
    examine,
)
from tests.shapegen.bodies import box, box_body

CONFIG = SoundnessConfig()


def reason_of(check: object, *arguments: object) -> Reason:
    with pytest.raises(UnsoundError) as caught:
        check(*arguments, CONFIG)  # type: ignore[operator]
    return caught.value.reason


def test_a_plain_block_is_sound() -> None:
    measures = examine(box_body(0.045, 0.035, 0.03), CONFIG)
    assert len(measures.poses) == 6
    assert measures.convexity == pytest.approx(1.0)
    assert measures.misfit == pytest.approx(0.0, abs=1e-9)
    assert measures.lifted == 1.0
    # The collision margin of 1 mm lifts what rests.
    assert measures.poses[0].height == pytest.approx(0.016, abs=5e-4)


def test_the_same_body_measures_the_same_bits() -> None:
    body = box_body(0.045, 0.035, 0.03)
    assert examine(body, CONFIG) == examine(body, CONFIG)


def test_nan_vertex() -> None:
    mesh = box(0.045, 0.035, 0.03)
    vertices = mesh.vertices.copy()
    vertices[3, 1] = np.nan
    assert reason_of(check_mesh, Mesh(vertices, mesh.faces)) is Reason.NOT_FINITE


def test_open_mesh() -> None:
    mesh = box(0.045, 0.035, 0.03)
    assert reason_of(check_mesh, Mesh(mesh.vertices, mesh.faces[1:])) is Reason.NOT_CLOSED


def test_two_bodies() -> None:
    cube = Solid.cube([0.01, 0.02, 0.02], True)
    pair = cube + cube.translate([0.035, 0.0, 0.0])
    assert reason_of(check_mesh, to_mesh(pair)) is Reason.SEVERAL_BODIES


def test_sizes_walls_and_faces() -> None:
    assert reason_of(check_mesh, box(0.03, 0.03, 0.03)) is Reason.SIZE
    assert reason_of(check_mesh, box(0.08, 0.03, 0.03)) is Reason.SIZE
    assert reason_of(check_mesh, box(0.05, 0.03, 0.001)) is Reason.THIN_WALL
    assert reason_of(check_mesh, to_mesh(Solid.sphere(0.025, 60))) is Reason.FACES


def test_masses_and_moments() -> None:
    body = box_body(0.045, 0.035, 0.03)
    assert reason_of(check_numbers, replace(body, mass=0.02)) is Reason.MASS
    assert reason_of(check_numbers, replace(body, mass=float("nan"))) is Reason.NOT_FINITE
    assert reason_of(check_numbers, replace(body, inertia=(1.0, 1.0, 0.0))) is Reason.INERTIA
    assert reason_of(check_numbers, replace(body, inertia=(1.0, 1.0, 3.0))) is Reason.INERTIA


def test_hulls_must_follow_the_mesh() -> None:
    body = box_body(0.045, 0.035, 0.03)
    larger = box(0.049, 0.035, 0.03)
    assert check_hulls(body, CONFIG) == (pytest.approx(0.0, abs=1e-9), 0.0)
    fat = Body(body.visual, (box(0.055, 0.035, 0.03),), body.mass, body.inertia)
    assert reason_of(check_hulls, fat) is Reason.MISFIT
    loose = replace(CONFIG, outside=0.001)
    with pytest.raises(UnsoundError, match="stands out"):
        check_hulls(Body(body.visual, (larger,), body.mass, body.inertia), loose)


def test_flat_and_wide() -> None:
    assert reason_of(examine, box_body(0.06, 0.05, 0.01, density=3000)) is Reason.TOO_FLAT
    assert reason_of(examine, box_body(0.06, 0.06, 0.03)) is Reason.TOO_WIDE


def test_what_slips_from_the_fingers_is_refused() -> None:
    pyramid = Solid.hull_points(
        np.array(
            [[x, y, -0.01] for x in (-0.022, 0.022) for y in (-0.022, 0.022)] + [[0, 0, 0.014]]
        )
    )
    mesh = to_mesh(pyramid)
    body = Body(mesh, (mesh,), 0.3, (6e-5, 6e-5, 8e-5))
    with pytest.raises(UnsoundError):
        examine(body, CONFIG)
