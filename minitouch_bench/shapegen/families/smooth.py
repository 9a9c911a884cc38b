"""Smooth families: bodies of spherical waves, and balls and capsules melted together."""

import math
from collections.abc import Callable

import numpy as np

from minitouch_bench.shapegen.mesh import Points
from minitouch_bench.shapegen.solids import Solid


def harmonic(rng: np.random.Generator) -> Solid:
    """Return a pebble, a lobed blob or a many-sided star body."""
    waves = int(rng.integers(3, 8))
    strength = rng.uniform(0.10, 0.34)
    axes = rng.normal(size=(waves, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    orders = rng.integers(2, 6, size=waves)
    phases = rng.uniform(0.0, 2.0 * np.pi, size=waves)
    weights = rng.normal(size=waves)
    weights *= strength / np.abs(weights).sum() * np.sqrt(waves)
    stretch = np.array([1.0, rng.uniform(0.55, 0.95), rng.uniform(0.45, 0.85)])
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))

    def deform(points: Points) -> Points:
        directions = points / np.linalg.norm(points, axis=1, keepdims=True)
        angles = np.arccos(np.clip(directions @ axes.T, -1.0, 1.0))
        radius = 1.0 + (weights * np.cos(orders * angles + phases)).sum(axis=1)
        stretched: Points = (np.maximum(radius, 0.4)[:, None] * directions @ rotation) * stretch
        return stretched

    return Solid.sphere(1.0, 48).warp_batch(deform)


GRID = 0.13
"""Edge of the sampling grid; the whole body is about 2 to 3 long."""


def melted(rng: np.random.Generator) -> Solid:
    """Return two to five capsules, each begun on the one before it, melted together."""
    count = int(rng.integers(2, 6))
    starts, ends, radii = [], [], []
    anchor = np.zeros(3)
    for _ in range(count):
        direction = rng.normal(size=3) * (1.0, 1.0, 0.6)
        direction /= np.linalg.norm(direction)
        end = anchor + direction * rng.uniform(0.35, 1.15)
        starts.append(anchor)
        ends.append(end)
        radii.append(rng.uniform(0.24, 0.5))
        anchor = starts[int(rng.integers(len(starts)))] if rng.random() < 0.3 else end
    begin, finish, radius = np.array(starts), np.array(ends), np.array(radii)
    field = _smooth_union(begin, finish - begin, radius, float(rng.uniform(0.04, 0.16)))
    corners = np.concatenate([begin, finish])
    low, high = corners.min(axis=0) - radius.max() - 0.3, corners.max(axis=0) + radius.max() + 0.3
    return Solid.level_set(field, [*low.tolist(), *high.tolist()], GRID, 0.0)


def _smooth_union(
    starts: Points, axes: Points, radii: Points, blend: float
) -> Callable[[float, float, float], float]:
    """Return the field of capsules, positive inside, joined by a soft maximum."""
    # Plain floats: the solver asks for one point at a time, where numpy is ten times slower.
    parts = [
        (*start, *axis, float(axis @ axis), radius)
        for start, axis, radius in zip(starts.tolist(), axes, radii.tolist(), strict=True)
    ]
    capsules = [tuple(float(number) for number in part) for part in parts]

    def field(x: float, y: float, z: float) -> float:
        depths = []
        for px, py, pz, ax, ay, az, length2, radius in capsules:
            dx, dy, dz = x - px, y - py, z - pz
            t = min(1.0, max(0.0, (dx * ax + dy * ay + dz * az) / length2))
            dx, dy, dz = dx - t * ax, dy - t * ay, dz - t * az
            depths.append(radius - math.sqrt(dx * dx + dy * dy + dz * dz))
        best = max(depths)
        return best + blend * math.log(sum(math.exp((d - best) / blend) for d in depths))

    return field
