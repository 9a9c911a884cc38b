"""Families of blocks: primitives added and cut by drills and planes, and bricks grown on a grid."""

import manifold3d
import numpy as np

from minitouch_bench.shapegen.solids import Solid, rounded_box, superquadric


def carved(rng: np.random.Generator) -> Solid:
    """Return a body of one to three primitives with none to three cuts."""
    half = np.array([1.0, rng.uniform(0.5, 0.9), rng.uniform(0.4, 0.8)])
    solid = _primitive(rng, half)
    for _ in range(int(rng.integers(0, 3))):
        small = half * rng.uniform(0.45, 0.8, size=3)
        center = rng.uniform(-0.75, 0.75, size=3) * half
        turn = rng.uniform(-50.0, 50.0, size=3).tolist()
        solid += _primitive(rng, small).rotate(turn).translate(center.tolist())
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


STEPS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


def stacked(rng: np.random.Generator) -> Solid:
    """Return three to seven cells joined face to face, with cells of unequal sides."""
    count = int(rng.integers(3, 8))
    cells = [(0, 0, 0)]
    while len(cells) < count:
        base = np.array(cells[int(rng.integers(len(cells)))])
        x, y, z = (base + STEPS[int(rng.integers(6))]).tolist()
        if (x, y, z) not in cells and max(abs(x), abs(y), abs(z)) <= 1:
            cells.append((x, y, z))
    # Unequal pitches along each axis make a continuum of the few polycubes there are.
    pitches = rng.uniform(0.6, 1.3, size=(3, 3))
    edges = np.concatenate([np.zeros((3, 1)), np.cumsum(pitches, axis=1)], axis=1)
    radius = float(rng.choice([0.0, rng.uniform(0.04, 0.18)]))
    shear = rng.uniform(-0.35, 0.35, size=2) * float(rng.random() < 0.35)
    pieces = []
    for cell in cells:
        at = np.array(cell) + 1
        low, high = edges[np.arange(3), at], edges[np.arange(3), at + 1]
        pieces.append(_brick(low, high, radius))
    solid = Solid.batch_boolean(pieces, manifold3d.OpType.Add)
    return solid.transform(
        [[1.0, 0.0, shear[0], 0.0], [0.0, 1.0, shear[1], 0.0], [0.0, 0.0, 1.0, 0.0]]
    )


def _brick(low: np.ndarray, high: np.ndarray, radius: float) -> Solid:
    """Return one cell, a little too large, so that neighbors overlap and join."""
    sides, middle = high - low + 0.02 + radius, (high + low) / 2.0
    block = Solid.cube(sides.tolist(), True) if radius == 0.0 else rounded_box(sides, radius)
    return block.translate(middle.tolist())
