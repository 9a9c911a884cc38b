"""Household things: turned vases and cups; mugs, baskets, hammers and others with a grip."""

import numpy as np

from minitouch_bench.shapegen.mesh import Points
from minitouch_bench.shapegen.solids import (
    Solid,
    capsule,
    outline,
    rounded_box,
    superquadric,
    tube_along,
)

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
    return Solid.revolve(outline(closed), sides)


def handled(rng: np.random.Generator) -> Solid:
    """Return one of six kinds of handled object."""
    makers = (_mug, _mug, _basket, _hammer, _ladle, _dumb_bell, _weight)
    return makers[int(rng.integers(len(makers)))](rng)


def _arc(start: float, end: float, radii: tuple[float, float]) -> Points:
    """Return an elliptic arc in the x-z plane, float64 (11, 3); angles in degrees."""
    angles = np.radians(np.linspace(start, end, 11))
    return np.stack([radii[0] * np.cos(angles), np.zeros(11), radii[1] * np.sin(angles)], axis=1)


def _mug(rng: np.random.Generator) -> Solid:
    height = float(rng.uniform(1.3, 2.2))
    heights, radii = profile(rng, height)
    radii = 0.55 + 0.35 * radii
    body = _revolved(np.stack([radii, heights], axis=1), int(rng.choice([6, 8, 32, 32])))
    middle, size = height * float(rng.uniform(0.45, 0.6)), float(rng.uniform(0.36, 0.5)) * height
    thickness = float(rng.uniform(0.13, 0.2))
    path = _arc(-90.0, 90.0, (float(rng.uniform(0.35, 0.6)), size - thickness))
    reach = float(np.interp(middle, heights, radii)) - 0.08
    body += tube_along(path + np.array([reach, 0.0, middle]), thickness)
    if rng.random() < 0.7:
        inner = float(radii.min()) - 0.17
        floor = height * float(rng.uniform(0.15, 0.4))
        body -= Solid.cylinder(4.0, inner, -1.0, 32).translate([0.0, 0.0, floor])
    return body


def _basket(rng: np.random.Generator) -> Solid:
    sides = np.array([1.8, rng.uniform(1.0, 1.7), rng.uniform(0.7, 1.1)])
    body = rounded_box(sides, 0.15)
    body -= Solid.cube((sides - 0.38).tolist(), True).translate([0.0, 0.0, 0.35])
    arch = _arc(0.0, 180.0, (0.78, float(rng.uniform(0.7, 1.1))))
    return body + tube_along(
        arch + np.array([0.0, 0.0, sides[2] / 2.0 - 0.15]), float(rng.uniform(0.14, 0.2))
    )


def _hammer(rng: np.random.Generator) -> Solid:
    length, thickness = float(rng.uniform(1.8, 2.6)), float(rng.uniform(0.2, 0.32))
    head = rng.uniform([0.45, 0.8, 0.45], [0.8, 1.6, 0.8])
    if rng.random() < 0.5:
        block = rounded_box(head, 0.1)
    else:
        block = superquadric(
            head / 2.0, (float(rng.uniform(0.3, 1.2)), float(rng.uniform(0.3, 1.2)))
        )
    grip = capsule(np.zeros(3), np.array([length, 0.0, 0.0]), thickness)
    return block + grip.scale([1.0, float(rng.uniform(0.8, 1.3)), 1.0])


def _ladle(rng: np.random.Generator) -> Solid:
    bowl = superquadric(np.array([0.8, 0.7, 0.55]), (1.0, float(rng.uniform(0.7, 1.0))))
    bowl = bowl.trim_by_plane([0.0, 0.0, -1.0], -float(rng.uniform(0.1, 0.35)))
    if rng.random() < 0.7:
        bowl -= Solid.sphere(0.5, 32).scale([1.1, 0.95, 0.8]).translate([0.0, 0.0, 0.25])
    length, thickness = float(rng.uniform(1.6, 2.2)), float(rng.uniform(0.17, 0.26))
    rise = float(rng.uniform(-0.1, 0.5))
    return bowl + capsule(np.array([0.72, 0.0, 0.0]), np.array([length, 0.0, rise]), thickness)


def _dumb_bell(rng: np.random.Generator) -> Solid:
    length, thickness = float(rng.uniform(1.7, 2.4)), float(rng.uniform(0.22, 0.4))
    solid = capsule(np.zeros(3), np.array([length, 0.0, 0.0]), thickness)
    sides = int(rng.choice([4, 6, 8, 32]))
    for end_x in (0.0, length):
        radius, width = float(rng.uniform(0.5, 0.8)), float(rng.uniform(0.35, 0.7))
        if rng.random() < 0.4:
            end = Solid.sphere(radius * 0.9, 28)
        else:
            end = Solid.cylinder(width, radius, -1.0, sides, True).rotate([0.0, 90.0, 0.0])
        solid += end.translate([end_x, 0.0, 0.0])
    return solid


def _weight(rng: np.random.Generator) -> Solid:
    half = np.array([rng.uniform(0.75, 1.0), rng.uniform(0.65, 0.9), rng.uniform(0.6, 0.9)])
    body = superquadric(half, (float(rng.uniform(0.4, 1.0)), float(rng.uniform(0.4, 1.0))))
    body = body.trim_by_plane([0.0, 0.0, 1.0], -0.75 * float(half[2]))
    arch = _arc(-10.0, 190.0, (float(rng.uniform(0.45, 0.65)), float(rng.uniform(0.6, 0.85))))
    return body + tube_along(
        arch + np.array([0.0, 0.0, 0.75 * half[2]]), float(rng.uniform(0.14, 0.22))
    )
