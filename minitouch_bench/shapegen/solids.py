"""The bridge between our meshes and manifold3d's solids, and what families build from."""

from itertools import product
from typing import TypeAlias

import fast_simplification
import manifold3d
import numpy as np

from minitouch_bench.shapegen.geometry import Mesh, Points

Solid: TypeAlias = manifold3d.Manifold
"""A closed 2-manifold solid of manifold3d."""


def to_solid(mesh: Mesh) -> Solid:
    """Return the solid a mesh bounds; an empty one where it is not a closed 2-manifold."""
    return Solid(
        manifold3d.Mesh64(
            np.ascontiguousarray(mesh.vertices, dtype=np.float64),
            np.ascontiguousarray(mesh.faces, dtype=np.uint64),
        )
    )


def to_mesh(solid: Solid) -> Mesh:
    """Return the boundary of a solid."""
    data = solid.to_mesh64()
    vertices = np.array(data.vert_properties[:, :3], dtype=np.float64)
    return Mesh(vertices, np.array(data.tri_verts, dtype=np.int32))


def hull_of(points: Points) -> Mesh:
    """Return the convex hull of (N, 3) points."""
    return to_mesh(Solid.hull_points(np.ascontiguousarray(points, dtype=np.float64)))


def union(solids: list[Solid]) -> Solid:
    """Return the union of solids."""
    return Solid.batch_boolean(solids, manifold3d.OpType.Add)


def turned(solid: Solid) -> Solid:
    """Return a solid whose inside is outside."""
    mesh = to_mesh(solid)
    return to_solid(Mesh(mesh.vertices, mesh.faces[:, ::-1]))


def grown(solid: Solid, factor: float) -> Solid:
    """Return a solid scaled around the middle of its box."""
    middle = np.array(solid.bounding_box()).reshape(2, 3).mean(axis=0)
    return solid.translate((-middle).tolist()).scale([factor] * 3).translate(middle.tolist())


def simplified(mesh: Mesh, faces: int) -> Mesh:
    """Return a mesh of about ``faces`` faces (quadric edge collapse), perhaps not a manifold."""
    if len(mesh.faces) <= faces:
        return mesh
    # fast_simplification stalls on coordinates in meters, so it works on a box of side 100.
    scale = 100.0 / float(mesh.extents.max())
    vertices, triangles = fast_simplification.simplify(
        np.ascontiguousarray(mesh.vertices * scale, dtype=np.float64),
        np.ascontiguousarray(mesh.faces, dtype=np.int32),
        target_reduction=1.0 - faces / len(mesh.faces),
        agg=7,
    )
    used, compact = np.unique(triangles, return_inverse=True)
    points = np.asarray(vertices, dtype=np.float64)[used] / scale
    return Mesh(points, compact.reshape(-1, 3).astype(np.int32))


def simplified_solid(solid: Solid, faces: int) -> Mesh:
    """Return a closed mesh of at most about ``faces`` faces, where that can be had."""
    mesh = to_mesh(solid)
    for target in (faces, faces * 7 // 8, faces * 3 // 4):
        small = simplified(mesh, target)
        check = to_solid(small)
        if not check.is_empty() and check.volume() > 0.0 and len(check.decompose()) == 1:
            return small
    # Slower to shrink and coarser, but it never breaks a closed surface.
    tolerance = float(mesh.extents.max()) / 1000.0
    for _ in range(6):
        if solid.num_tri() <= faces:
            break
        solid, tolerance = solid.simplify(tolerance), 1.6 * tolerance
    return to_mesh(solid)


def superquadric(half_sides: Points, roundness: tuple[float, float]) -> Solid:
    """Return a superquadric: exponents near 0.2 give a box, 1 an ellipsoid, 1.8 a diamond."""
    east, north = roundness

    def signed_power(values: Points, exponent: float) -> Points:
        return np.sign(values) * np.abs(values) ** exponent

    def deform(points: Points) -> Points:
        unit = points / np.linalg.norm(points, axis=1, keepdims=True)
        level = np.hypot(unit[:, 0], unit[:, 1])
        safe = np.maximum(level, 1e-12)
        ring = signed_power(level, north)
        x = ring * signed_power(unit[:, 0] / safe, east)
        y = ring * signed_power(unit[:, 1] / safe, east)
        z = signed_power(unit[:, 2], north)
        return np.stack([x, y, z], axis=1) * half_sides

    return Solid.sphere(1.0, 40).warp_batch(deform)


def rounded_box(sides: Points, radius: float) -> Solid:
    """Return a box with rounded edges, centered: the hull of eight balls."""
    inner = np.maximum(sides / 2.0 - radius, 1e-3)
    ball = Solid.sphere(radius, 12)
    corners = inner * list(product((-1, 1), repeat=3))
    return Solid.batch_hull([ball.translate(corner) for corner in corners.tolist()])


def capsule(start: Points, end: Points, radius: float) -> Solid:
    """Return the hull of two equal balls."""
    ball = Solid.sphere(radius, 16)
    return Solid.batch_hull([ball.translate(start.tolist()), ball.translate(end.tolist())])


def tube_along(path: Points, radius: float) -> Solid:
    """Return capsules joined along a path of (N, 3) points."""
    return union([capsule(path[i], path[i + 1], radius) for i in range(len(path) - 1)])


def outline(points: Points) -> manifold3d.CrossSection:
    """Return the plane region inside a closed polygon of (N, 2) points."""
    return manifold3d.CrossSection([np.ascontiguousarray(points, dtype=np.float64)])


def rounded(region: manifold3d.CrossSection, radius: float) -> manifold3d.CrossSection:
    """Round the corners of a plane region, outer and inner, by opening and closing it."""
    join = manifold3d.JoinType.Round
    opened = region.offset(-radius, join, 2.0, 16).offset(2.0 * radius, join, 2.0, 16)
    return opened.offset(-radius, join, 2.0, 16).simplify(radius * 0.02)


def random_outline(rng: np.random.Generator) -> manifold3d.CrossSection:
    """Return a polygon, a star, a gear, a wavy disc, a letter or an arrow, about 2 across."""
    makers = (_polygon, _star, _gear, _wave, _letter, _letter, _arrow, _crescent)
    region = makers[int(rng.integers(len(makers)))](rng)
    if rng.random() < 0.6:
        region = rounded(region, rng.uniform(0.04, 0.12))
    return region.scale([1.0, rng.uniform(0.6, 1.0)])


def _ring(radii: np.ndarray, turn: float = 0.0) -> manifold3d.CrossSection:
    angles = np.arange(len(radii)) * 2.0 * np.pi / len(radii) + turn
    return outline(np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1))


def _polygon(rng: np.random.Generator) -> manifold3d.CrossSection:
    count = int(rng.integers(3, 9))
    return _ring(rng.uniform(0.7, 1.0, size=count), rng.uniform(0.0, 1.0))


def _star(rng: np.random.Generator) -> manifold3d.CrossSection:
    points = int(rng.integers(3, 7))
    return _ring(np.tile([1.0, rng.uniform(0.5, 0.75)], points))


def _gear(rng: np.random.Generator) -> manifold3d.CrossSection:
    teeth = int(rng.integers(3, 7))
    low = rng.uniform(0.68, 0.85)
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
    bar = rng.uniform(0.42, 0.62)
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
    neck, head = rng.uniform(0.28, 0.5), rng.uniform(-0.2, 0.4)
    upper = [[1.0, 0.0], [head, 0.9], [head, neck], [-1.0, neck * rng.uniform(0.8, 1.6)]]
    lower = [[x, -y] for x, y in upper[:0:-1]]
    return outline(np.array(upper + lower))


def _crescent(rng: np.random.Generator) -> manifold3d.CrossSection:
    bite = manifold3d.CrossSection.circle(rng.uniform(0.45, 0.85), 40)
    return manifold3d.CrossSection.circle(1.0, 48) - bite.translate([rng.uniform(0.7, 1.0), 0.0])
