"""Plain bodies whose numbers are known."""

import numpy as np

from minitouch_bench.shapegen.body_codec import Body, quantized
from minitouch_bench.shapegen.geometry import Mesh, solid_moments
from minitouch_bench.shapegen.solids import Solid, to_mesh


def box(*sides: float) -> Mesh:
    """Return a box centered at the origin; sides in m."""
    mesh = to_mesh(Solid.cube(list(sides), True))
    return Mesh(quantized(mesh.vertices), mesh.faces)


BLOCK = (0.08, 0.046, 0.044)
"""Sides of a box that is sound (m): 80 mm high on its smallest face, 64 mm wide there."""


def box_body(*sides: float, density: float = 9000.0) -> Body:
    """Return a solid box as a body of one hull."""
    mesh = box(*sides)
    moments = solid_moments(mesh)
    ixx, iyy, izz = (np.diag(moments.inertia) * density).tolist()
    return Body(mesh, (mesh,), moments.volume * density, (ixx, iyy, izz))
