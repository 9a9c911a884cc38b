"""Boolean work: superquadrics, boxes and cylinders added, then cut by drills and planes."""

import numpy as np

from minitouch_bench.shapegen.families.primitives import rounded_box, superquadric
from minitouch_bench.shapegen.solids import Solid


def carved(rng: np.random.Generator) -> Solid:
    """Return a body of one to three primitives with none to three cuts."""
    half = np.array([1.0, rng.uniform(0.5, 0.9), rng.uniform(0.4, 0.8)])
    solid = _primitive(rng, half)
    for _ in range(int(rng.integers(0, 3))):
        small = half * rng.uniform(0.45, 0.8, size=3)
        place = rng.uniform(-0.75, 0.75, size=3) * half
        turn = rng.uniform(-50.0, 50.0, size=3).tolist()
        solid += _primitive(rng, small).rotate(turn).translate(place.tolist())
    for _ in range(int(rng.integers(0, 4))):
        solid = _cut(rng, solid, half)
    return solid


def _primitive(rng: np.random.Generator, half: np.ndarray) -> Solid:
    """Return a superquadric, a rounded box, a cylinder, a cone or a wedge of these half sides."""
    kind = rng.integers(6)
    if kind <= 1:
        roundness = (float(rng.uniform(0.2, 1.6)), float(rng.uniform(0.2, 1.6)))
        return superquadric(half, roundness)
    if kind == 2:
        return rounded_box(2.0 * half, float(rng.uniform(0.05, 0.6) * half.min()))
    sides = int(rng.choice([3, 4, 5, 6, 8, 32]))
    top = float(rng.choice([1.0, rng.uniform(0.35, 0.8)]))
    prism = Solid.cylinder(2.0, 1.0, top, sides, True).rotate([0.0, 0.0, 180.0 / sides])
    if kind == 3:
        return prism.scale([half[0], half[1], half[2]])
    return prism.scale([half[2], half[1], half[0]]).rotate([0.0, 90.0, 0.0])


def _cut(rng: np.random.Generator, solid: Solid, half: np.ndarray) -> Solid:
    """Return the solid after one cut: a plane, a drill through it, a slot or a scoop."""
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    kind = rng.integers(4)
    if kind == 0:
        depth = -float(rng.uniform(0.45, 0.8)) * float(np.abs(direction * half).sum())
        return solid.trim_by_plane(direction.tolist(), depth)
    axis = int(rng.integers(3))
    reach = float(np.delete(half, axis).min())
    offset = rng.uniform(-0.35, 0.35, size=3) * half
    if kind == 1:
        drill = Solid.cylinder(6.0, reach * rng.uniform(0.2, 0.42), -1.0, 24, True)
        return solid - drill.rotate(_towards(axis)).translate(offset.tolist())
    if kind == 2:
        width = float(reach * rng.uniform(0.25, 0.5))
        slot = Solid.cube([width, 6.0, 6.0], True).translate([0.0, 0.0, 3.0 + 0.1 * reach])
        turn = float(rng.uniform(0.0, 180.0))
        return solid - slot.rotate([0.0, 0.0, turn]).translate(offset.tolist())
    radius = float(rng.uniform(0.35, 0.7) * half.max())
    surface = float(np.linalg.norm(direction * half)) + radius * float(rng.uniform(0.35, 0.7))
    return solid - Solid.sphere(radius, 32).translate((direction * surface).tolist())


def _towards(axis: int) -> list[float]:
    """Return the Euler angles that lay the z axis along an axis."""
    return [[0.0, 90.0, 0.0], [90.0, 0.0, 0.0], [0.0, 0.0, 0.0]][axis]
