"""Families on random plane outlines: thick cut-outs, and columns that twist, taper or bend."""

import manifold3d
import numpy as np

from minitouch_bench.shapegen.mesh import Points
from minitouch_bench.shapegen.solids import Solid, outline, rounded


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
    height = float(rng.uniform(1.8, 3.6))
    twist = float(rng.uniform(15.0, 95.0) * rng.choice([-1, 1]))
    top = float(rng.uniform(0.45, 1.0))
    column = Solid.extrude(random_outline(rng), height, 24, twist, (top, top))
    bulge = float(rng.uniform(-0.25, 0.4))
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


def random_outline(rng: np.random.Generator) -> manifold3d.CrossSection:
    """Return a polygon, a star, a gear, a wavy disc, a letter or an arrow, about 2 across."""
    makers = (_polygon, _star, _gear, _wave, _letter, _letter, _arrow, _crescent)
    region = makers[int(rng.integers(len(makers)))](rng)
    if rng.random() < 0.6:
        region = rounded(region, float(rng.uniform(0.04, 0.12)))
    return region.scale([1.0, float(rng.uniform(0.6, 1.0))])


def _ring(radii: np.ndarray, turn: float = 0.0) -> manifold3d.CrossSection:
    angles = np.arange(len(radii)) * 2.0 * np.pi / len(radii) + turn
    return outline(np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1))


def _polygon(rng: np.random.Generator) -> manifold3d.CrossSection:
    count = int(rng.integers(3, 9))
    return _ring(rng.uniform(0.7, 1.0, size=count), float(rng.uniform(0.0, 1.0)))


def _star(rng: np.random.Generator) -> manifold3d.CrossSection:
    points = int(rng.integers(3, 7))
    return _ring(np.tile([1.0, float(rng.uniform(0.5, 0.75))], points))


def _gear(rng: np.random.Generator) -> manifold3d.CrossSection:
    teeth = int(rng.integers(3, 7))
    low = float(rng.uniform(0.68, 0.85))
    return _ring(np.tile([1.0, 1.0, low, low], teeth))


def _wave(rng: np.random.Generator) -> manifold3d.CrossSection:
    angles = np.arange(64) * 2.0 * np.pi / 64
    radii = np.full(64, 1.0)
    for order in range(2, 6):
        weight = rng.normal() * 0.45 / order
        radii += weight * np.cos(order * angles + rng.uniform(0.0, 2.0 * np.pi))
    return _ring(np.maximum(radii, 0.45))


def _letter(rng: np.random.Generator) -> manifold3d.CrossSection:
    """Bars on a square: L, T, U, H, X, Z, E, F or plus."""
    bar = float(rng.uniform(0.42, 0.62))
    edge = 1.0 - bar / 2.0
    bars = {
        "left": (-edge, 0.0, bar, 2.0),
        "right": (edge, 0.0, bar, 2.0),
        "middle": (0.0, 0.0, bar, 2.0),
        "top": (0.0, edge, 2.0, bar),
        "bottom": (0.0, -edge, 2.0, bar),
        "center": (0.0, 0.0, 2.0, bar),
        "stub": (-0.5, -edge, 1.0, bar),
        "nub": (0.5, edge, 1.0, bar),
    }
    words = (
        ("left", "bottom"), ("middle", "top"), ("left", "right", "bottom"),
        ("left", "right", "center"), ("middle", "center"), ("middle", "stub", "nub"),
        ("left", "top", "center"), ("middle", "top", "bottom"),
    )  # fmt: skip
    region = manifold3d.CrossSection()
    for name in words[int(rng.integers(len(words)))]:
        x, y, width, height = bars[name]
        region += manifold3d.CrossSection.square([width, height], True).translate([x, y])
    return region


def _arrow(rng: np.random.Generator) -> manifold3d.CrossSection:
    neck, head = float(rng.uniform(0.28, 0.5)), float(rng.uniform(-0.2, 0.4))
    upper = [[1.0, 0.0], [head, 0.9], [head, neck], [-1.0, neck * float(rng.uniform(0.8, 1.6))]]
    lower = [[x, -y] for x, y in upper[:0:-1]]
    return outline(np.array(upper + lower))


def _crescent(rng: np.random.Generator) -> manifold3d.CrossSection:
    bite = manifold3d.CrossSection.circle(float(rng.uniform(0.45, 0.85)), 40)
    return manifold3d.CrossSection.circle(1.0, 48) - bite.translate(
        [float(rng.uniform(0.7, 1.0)), 0.0]
    )
