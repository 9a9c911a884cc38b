"""Bricks grown cell by cell on a small grid, as building toys are."""

import manifold3d
import numpy as np

from minitouch_bench.shapegen.families.primitives import rounded_box
from minitouch_bench.shapegen.solids import Solid

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
