"""Prisms on random outlines, with holes through them, a step or a bevelled top."""

import manifold3d
import numpy as np

from minitouch_bench.shapegen.families.outlines import random_outline
from minitouch_bench.shapegen.solids import Solid


def extruded(rng: np.random.Generator) -> Solid:
    """Return a thick cut-out with none to two holes."""
    region = random_outline(rng)
    height = float(rng.uniform(0.75, 1.5))
    kind = rng.random()
    if kind < 0.25:  # a second, smaller layer on the first
        step = height * float(rng.uniform(0.35, 0.65))
        upper = region.offset(-float(rng.uniform(0.12, 0.25)), manifold3d.JoinType.Miter)
        solid = Solid.extrude(region, step) + Solid.extrude(upper, height)
    elif kind < 0.5:  # tapered sides
        top = float(rng.uniform(0.6, 0.9))
        solid = Solid.extrude(region, height, 0, 0.0, (top, top))
    else:
        solid = Solid.extrude(region, height)
    for _ in range(int(rng.choice([0, 1, 1, 2]))):
        solid = _pierced(rng, solid, region, height)
    return solid


def _pierced(
    rng: np.random.Generator, solid: Solid, region: manifold3d.CrossSection, height: float
) -> Solid:
    """Return the solid with one hole that leaves a wall all round, where it finds a place."""
    for _ in range(12):
        radius = float(rng.uniform(0.14, 0.34))
        place = rng.uniform(-0.65, 0.65, size=2)
        sides = int(rng.choice([4, 6, 24]))
        guard = manifold3d.CrossSection.circle(radius + 0.17, 24).translate(place.tolist())
        if (guard - region).area() < 1e-6:
            drill = Solid.cylinder(4.0, radius, -1.0, sides, True)
            depth = height * float(rng.choice([-1.0, rng.uniform(0.3, 0.6)]))
            lift = 0.0 if depth < 0 else 2.0 + depth
            return solid - drill.translate([*place.tolist(), lift])
    return solid
