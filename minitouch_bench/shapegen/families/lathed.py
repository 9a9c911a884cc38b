"""Turned bodies: a profile revolved, solid or hollowed into a cup, round or many-sided."""

import manifold3d
import numpy as np

from minitouch_bench.shapegen.families.primitives import outline
from minitouch_bench.shapegen.mesh import Points
from minitouch_bench.shapegen.solids import Solid

WALL = 0.17
"""Least wall of a cup, where its largest radius is about 1."""


def lathed(rng: np.random.Generator) -> Solid:
    """Return a vase, a spool, a bottle, a pawn, a bowl or a cup."""
    height = float(rng.uniform(1.1, 3.0))
    heights, radii = profile(rng, height)
    sides = int(rng.choice([5, 6, 7, 8, 36, 36, 36, 36]))
    body = _revolved(np.stack([radii, heights], axis=1), sides)
    if rng.random() < 0.5:
        floor = float(rng.uniform(0.2, 0.65)) * height
        wall = WALL + float(rng.uniform(0.0, 0.12))
        inside = heights >= floor
        cavity_z = np.concatenate([[floor], heights[inside], [height + 0.5]])
        inner = np.maximum(np.interp(cavity_z, heights, radii) - wall, 0.0)
        # A throat narrower than what lies below it could neither be milled nor seen into.
        inner = np.minimum.accumulate(inner[::-1])[::-1] if rng.random() < 0.5 else inner
        if inner.min() > 0.2:
            body -= _revolved(np.stack([inner, cavity_z], axis=1), sides)
    flatten = float(rng.choice([1.0, 1.0, rng.uniform(0.6, 0.9)]))
    return body.scale([1.0, flatten, 1.0])


def profile(rng: np.random.Generator, height: float) -> tuple[Points, Points]:
    """Return heights and radii (N,) of a random smooth, or stepped, profile."""
    knots = int(rng.integers(3, 7))
    at = np.linspace(0.0, height, knots)
    values = rng.uniform(0.38, 1.0, size=knots)
    if rng.random() < 0.3:  # steps, as of a turned pawn or a bolt
        edges = np.repeat(at, 2)[1:-1]
        edges[1:-1] += np.tile([-0.03, 0.03], knots - 2) * height
        return np.interp(np.linspace(0, 1, 24), np.linspace(0, 1, len(edges)), edges), np.interp(
            np.linspace(0, 1, 24), np.linspace(0, 1, len(edges)), np.repeat(values[:-1], 2)
        )
    heights = np.linspace(0.0, height, 25)
    return heights, _smooth_through(heights, at, values)


def _smooth_through(x: Points, at: Points, values: Points) -> Points:
    """Interpolate by half cosines: smooth, and never beyond the values."""
    cell = np.clip(np.searchsorted(at, x, side="right") - 1, 0, len(at) - 2)
    t = (x - at[cell]) / (at[cell + 1] - at[cell])
    blend = (1.0 - np.cos(np.pi * t)) / 2.0
    smooth: Points = values[cell] * (1.0 - blend) + values[cell + 1] * blend
    return smooth


def _revolved(curve: Points, sides: int) -> Solid:
    """Revolve a curve of (radius, height) points, closed along the axis."""
    closed = np.concatenate([[[0.0, curve[0, 1]]], curve, [[0.0, curve[-1, 1]]]])
    region: manifold3d.CrossSection = outline(closed)
    return Solid.revolve(region, sides)
