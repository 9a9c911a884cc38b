"""Shapes and small sets that many tests start from."""

from pathlib import Path

import numpy as np
import pytest
from minitouch_bench.shapegen.entries import write_set
from minitouch_bench.shapegen.manifest import canonical_shape_set
from minitouch_bench.shapegen.mesh import Mesh, solid_moments
from minitouch_bench.shapegen.record import Body, quantised
from minitouch_bench.shapegen.solids import Solid, to_mesh


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINITOUCH_CACHE", str(tmp_path / "cache"))


def box(*sides: float) -> Mesh:
    """Return a box centred at the origin; sides in m."""
    mesh = to_mesh(Solid.cube(list(sides), True))
    return Mesh(quantised(mesh.vertices), mesh.faces)


def box_body(*sides: float, density: float = 2000.0) -> Body:
    """Return a solid box as a body of one hull."""
    mesh = box(*sides)
    moments = solid_moments(mesh)
    ixx, iyy, izz = (np.diag(moments.inertia()) * density).tolist()
    return Body(mesh, (mesh,), moments.volume * density, (ixx, iyy, izz))


@pytest.fixture
def small_set(tmp_path: Path) -> Path:
    """Return the folder of a set of the first 16 canonical shapes."""
    made = []
    for shape in canonical_shape_set().shapes[:16]:
        place = ("split", "offset", "length")
        entry = {key: value for key, value in shape.entry.items() if key not in place}
        made.append((entry, shape.record()))
    folder = tmp_path / "set"
    folder.mkdir()
    write_set(folder, {"name": "small", "generator": 1, "seed": 0}, made)
    return folder
