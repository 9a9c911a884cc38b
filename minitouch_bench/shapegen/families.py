"""Families of shapes: each a pure function of a random generator.

A family returns a closed solid of any size; ``generate.sized`` gives it its size and its frame.
"""

import math
from collections.abc import Callable, Mapping

import manifold3d
import numpy as np

from minitouch_bench.shapegen.geometry import Points
from minitouch_bench.shapegen.solids import (
    Solid,
    capsule,
    outline,
    random_outline,
    rounded_box,
    superquadric,
    tube_along,
    union,
)

Family = Callable[[np.random.Generator], Solid]

# Smooth: bodies of spherical waves, and balls and capsules melted together


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
        return (np.maximum(radius, 0.4)[:, None] * directions @ rotation) * stretch

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
    field = _smooth_union(begin, finish - begin, radius, rng.uniform(0.04, 0.16))
    corners = np.concatenate([begin, finish])
    low, high = corners.min(axis=0) - radius.max() - 0.3, corners.max(axis=0) + radius.max() + 0.3
    return Solid.level_set(field, [*low.tolist(), *high.tolist()], GRID, 0.0)


def _smooth_union(
    starts: Points, axes: Points, radii: Points, blend: float
) -> Callable[[float, float, float], float]:
    """Return the field of capsules, positive inside, joined by a soft maximum."""
    # Plain floats: the solver asks for one point at a time, where numpy is ten times slower.
    capsules = [
        (*start, *axis.tolist(), float(axis @ axis), radius)
        for start, axis, radius in zip(starts.tolist(), axes, radii.tolist(), strict=True)
    ]

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


# Blocks: primitives added and cut, and bricks grown on a grid


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
        roundness = (rng.uniform(0.2, 1.6), rng.uniform(0.2, 1.6))
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
        depth = -rng.uniform(0.45, 0.8) * float(np.abs(direction * half).sum())
        return solid.trim_by_plane(direction.tolist(), depth)
    axis = int(rng.integers(3))
    reach = float(np.delete(half, axis).min())
    offset = rng.uniform(-0.35, 0.35, size=3) * half
    if kind == 1:
        drill = Solid.cylinder(6.0, reach * rng.uniform(0.2, 0.42), -1.0, 24, True)
        along = [[0.0, 90.0, 0.0], [90.0, 0.0, 0.0], [0.0, 0.0, 0.0]][axis]
        return solid - drill.rotate(along).translate(offset.tolist())
    if kind == 2:
        width = float(reach * rng.uniform(0.25, 0.5))
        slot = Solid.cube([width, 6.0, 6.0], True).translate([0.0, 0.0, 3.0 + 0.1 * reach])
        turn = rng.uniform(0.0, 180.0)
        return solid - slot.rotate([0.0, 0.0, turn]).translate(offset.tolist())
    radius = float(rng.uniform(0.35, 0.7) * half.max())
    surface = float(np.linalg.norm(direction * half)) + radius * rng.uniform(0.35, 0.7)
    return solid - Solid.sphere(radius, 32).translate((direction * surface).tolist())


NEIGHBORS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


def stacked(rng: np.random.Generator) -> Solid:
    """Return three to seven cells joined face to face, with cells of unequal sides."""
    count = int(rng.integers(3, 8))
    cells = [(0, 0, 0)]
    while len(cells) < count:
        base = np.array(cells[int(rng.integers(len(cells)))])
        x, y, z = (base + NEIGHBORS[int(rng.integers(6))]).tolist()
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
        # A little too large, so that neighbors overlap and join.
        sides = high - low + 0.02 + radius
        block = Solid.cube(sides.tolist(), True) if radius == 0.0 else rounded_box(sides, radius)
        pieces.append(block.translate(((high + low) / 2.0).tolist()))
    return union(pieces).transform(
        [[1.0, 0.0, shear[0], 0.0], [0.0, 1.0, shear[1], 0.0], [0.0, 0.0, 1.0, 0.0]]
    )


# On plane outlines: thick cut-outs, and columns that twist, taper or bend


def extruded(rng: np.random.Generator) -> Solid:
    """Return a thick cut-out with none to two holes."""
    region = random_outline(rng)
    height = rng.uniform(0.75, 1.5)
    kind = rng.random()
    if kind < 0.25:  # a second, smaller layer on the first
        step = height * rng.uniform(0.35, 0.65)
        upper = region.offset(-rng.uniform(0.12, 0.25), manifold3d.JoinType.Miter)
        solid = Solid.extrude(region, step) + Solid.extrude(upper, height)
    elif kind < 0.5:  # tapered sides
        top = rng.uniform(0.6, 0.9)
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
        radius = rng.uniform(0.14, 0.34)
        center = rng.uniform(-0.65, 0.65, size=2)
        sides = int(rng.choice([4, 6, 24]))
        guard = manifold3d.CrossSection.circle(radius + 0.17, 24).translate(center.tolist())
        if (guard - region).area() < 1e-6:
            drill = Solid.cylinder(4.0, radius, -1.0, sides, True)
            depth = height * float(rng.choice([-1.0, rng.uniform(0.3, 0.6)]))
            lift = 0.0 if depth < 0 else 2.0 + depth
            return solid - drill.translate([*center.tolist(), lift])
    return solid


def twisted(rng: np.random.Generator) -> Solid:
    """Return a column that turns, narrows, leans or swells from its foot to its head."""
    height = rng.uniform(1.8, 3.6)
    twist = float(rng.uniform(15.0, 95.0) * rng.choice([-1, 1]))
    top = rng.uniform(0.45, 1.0)
    column = Solid.extrude(random_outline(rng), height, 24, twist, (top, top))
    bulge = rng.uniform(-0.25, 0.4)
    bend = float(rng.choice([0.0, rng.uniform(0.15, 0.6)])) / height

    def deform(points: Points) -> Points:
        share = points[:, 2] / height
        swell = 1.0 + bulge * np.sin(np.pi * share)
        x, y = points[:, 0] * swell, points[:, 1] * swell
        if bend > 0.0:
            radius = 1.0 / bend
            angle = points[:, 2] * bend
            return np.stack(
                [radius - (radius - x) * np.cos(angle), y, (radius - x) * np.sin(angle)], axis=1
            )
        return np.stack([x, y, points[:, 2]], axis=1)

    return column.warp_batch(deform)


# Household things: turned ones, and ones with a grip

WALL = 0.17
"""Least wall of a cup, where its largest radius is about 1."""


def lathed(rng: np.random.Generator) -> Solid:
    """Return a vase, a spool, a bottle, a pawn, a bowl or a cup."""
    height = rng.uniform(1.1, 3.0)
    heights, radii = profile(rng, height)
    sides = int(rng.choice([5, 6, 7, 8, 36, 36, 36, 36]))
    body = _revolved(np.stack([radii, heights], axis=1), sides)
    if rng.random() < 0.5:
        floor = rng.uniform(0.2, 0.65) * height
        wall = WALL + rng.uniform(0.0, 0.12)
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
        sampled, places = np.linspace(0, 1, 24), np.linspace(0, 1, len(edges))
        radii = np.interp(sampled, places, np.repeat(values[:-1], 2))
        return np.interp(sampled, places, edges), radii
    heights = np.linspace(0.0, height, 25)
    # Half cosines between the knots: smooth, and never beyond the values.
    cell = np.clip(np.searchsorted(at, heights, side="right") - 1, 0, knots - 2)
    blend = (1.0 - np.cos(np.pi * (heights - at[cell]) / (at[cell + 1] - at[cell]))) / 2.0
    return heights, values[cell] * (1.0 - blend) + values[cell + 1] * blend


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
    height = rng.uniform(1.3, 2.2)
    heights, radii = profile(rng, height)
    radii = 0.55 + 0.35 * radii
    body = _revolved(np.stack([radii, heights], axis=1), int(rng.choice([6, 8, 32, 32])))
    middle, size = height * rng.uniform(0.45, 0.6), rng.uniform(0.36, 0.5) * height
    thickness = rng.uniform(0.13, 0.2)
    path = _arc(-90.0, 90.0, (rng.uniform(0.35, 0.6), size - thickness))
    reach = float(np.interp(middle, heights, radii)) - 0.08
    body += tube_along(path + np.array([reach, 0.0, middle]), thickness)
    if rng.random() < 0.7:
        inner = float(radii.min()) - 0.17
        floor = height * rng.uniform(0.15, 0.4)
        body -= Solid.cylinder(4.0, inner, -1.0, 32).translate([0.0, 0.0, floor])
    return body


def _basket(rng: np.random.Generator) -> Solid:
    sides = np.array([1.8, rng.uniform(1.0, 1.7), rng.uniform(0.7, 1.1)])
    body = rounded_box(sides, 0.15)
    body -= Solid.cube((sides - 0.38).tolist(), True).translate([0.0, 0.0, 0.35])
    arch = _arc(0.0, 180.0, (0.78, rng.uniform(0.7, 1.1)))
    return body + tube_along(
        arch + np.array([0.0, 0.0, sides[2] / 2.0 - 0.15]), rng.uniform(0.14, 0.2)
    )


def _hammer(rng: np.random.Generator) -> Solid:
    length, thickness = rng.uniform(1.8, 2.6), rng.uniform(0.2, 0.32)
    head = rng.uniform([0.45, 0.8, 0.45], [0.8, 1.6, 0.8])
    if rng.random() < 0.5:
        block = rounded_box(head, 0.1)
    else:
        block = superquadric(head / 2.0, (rng.uniform(0.3, 1.2), rng.uniform(0.3, 1.2)))
    grip = capsule(np.zeros(3), np.array([length, 0.0, 0.0]), thickness)
    return block + grip.scale([1.0, rng.uniform(0.8, 1.3), 1.0])


def _ladle(rng: np.random.Generator) -> Solid:
    bowl = superquadric(np.array([0.8, 0.7, 0.55]), (1.0, rng.uniform(0.7, 1.0)))
    bowl = bowl.trim_by_plane([0.0, 0.0, -1.0], -rng.uniform(0.1, 0.35))
    if rng.random() < 0.7:
        bowl -= Solid.sphere(0.5, 32).scale([1.1, 0.95, 0.8]).translate([0.0, 0.0, 0.25])
    length, thickness = rng.uniform(1.6, 2.2), rng.uniform(0.17, 0.26)
    rise = rng.uniform(-0.1, 0.5)
    return bowl + capsule(np.array([0.72, 0.0, 0.0]), np.array([length, 0.0, rise]), thickness)


def _dumb_bell(rng: np.random.Generator) -> Solid:
    length, thickness = rng.uniform(1.7, 2.4), rng.uniform(0.22, 0.4)
    solid = capsule(np.zeros(3), np.array([length, 0.0, 0.0]), thickness)
    sides = int(rng.choice([4, 6, 8, 32]))
    for end_x in (0.0, length):
        radius, width = rng.uniform(0.5, 0.8), rng.uniform(0.35, 0.7)
        if rng.random() < 0.4:
            end = Solid.sphere(radius * 0.9, 28)
        else:
            end = Solid.cylinder(width, radius, -1.0, sides, True).rotate([0.0, 90.0, 0.0])
        solid += end.translate([end_x, 0.0, 0.0])
    return solid


def _weight(rng: np.random.Generator) -> Solid:
    half = np.array([rng.uniform(0.75, 1.0), rng.uniform(0.65, 0.9), rng.uniform(0.6, 0.9)])
    body = superquadric(half, (rng.uniform(0.4, 1.0), rng.uniform(0.4, 1.0)))
    body = body.trim_by_plane([0.0, 0.0, 1.0], -0.75 * float(half[2]))
    arch = _arc(-10.0, 190.0, (rng.uniform(0.45, 0.65), rng.uniform(0.6, 0.85)))
    return body + tube_along(arch + np.array([0.0, 0.0, 0.75 * half[2]]), rng.uniform(0.14, 0.22))


FAMILIES: Mapping[str, Family] = {
    "harmonic": harmonic,
    "melted": melted,
    "carved": carved,
    "lathed": lathed,
    "extruded": extruded,
    "twisted": twisted,
    "handled": handled,
    "stacked": stacked,
}
"""Every family by name; shape i belongs to family i modulo their number.

So another entry makes other sets: raise GENERATOR_VERSION, generate ``shapes/`` again, and set
its digest in ``protocol/minitouch.py``.
"""

GENERATOR_VERSION = 2
"""Raised whenever the same seed would give another shape."""
