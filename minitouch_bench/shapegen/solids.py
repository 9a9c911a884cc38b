"""The bridge between our meshes and manifold3d's solids, and what families build from."""

from typing import TypeAlias

import fast_simplification
import manifold3d
import numpy as np

from minitouch_bench.shapegen.mesh import Mesh, Points

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


def union_of(meshes: tuple[Mesh, ...]) -> Solid:
    """Return the union of closed meshes."""
    return Solid.batch_boolean([to_solid(mesh) for mesh in meshes], manifold3d.OpType.Add)


def symmetric_difference(first: Solid, second: Solid) -> float:
    """Return the volume that belongs to one of two solids only."""
    return float((first - second).volume() + (second - first).volume())


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


def superquadric(half_sides: Points, roundness: tuple[float, float]) -> Solid:
    """Return a superquadric: exponents near 0.2 give a box, 1 an ellipsoid, 1.8 a diamond."""
    east, north = roundness

    def signed_power(values: Points, exponent: float) -> Points:
        powered: Points = np.sign(values) * np.abs(values) ** exponent
        return powered

    def deform(points: Points) -> Points:
        unit = points / np.linalg.norm(points, axis=1, keepdims=True)
        level = np.hypot(unit[:, 0], unit[:, 1])
        safe = np.maximum(level, 1e-12)
        ring = signed_power(level, north)
        x = ring * signed_power(unit[:, 0] / safe, east)
        y = ring * signed_power(unit[:, 1] / safe, east)
        z = signed_power(unit[:, 2], north)
        placed: Points = np.stack([x, y, z], axis=1) * half_sides
        return placed

    return Solid.sphere(1.0, 40).warp_batch(deform)


def rounded_box(sides: Points, radius: float) -> Solid:
    """Return a box with rounded edges, centered: the hull of eight balls."""
    inner = np.maximum(sides / 2.0 - radius, 1e-3)
    ball = Solid.sphere(radius, 12)
    corners = [
        ball.translate([x * inner[0], y * inner[1], z * inner[2]])
        for x in (-1, 1)
        for y in (-1, 1)
        for z in (-1, 1)
    ]
    return Solid.batch_hull(corners)


def capsule(start: Points, end: Points, radius: float) -> Solid:
    """Return the hull of two equal balls."""
    ball = Solid.sphere(radius, 16)
    return Solid.batch_hull([ball.translate(start.tolist()), ball.translate(end.tolist())])


def tube_along(path: Points, radius: float) -> Solid:
    """Return capsules joined along a path of (N, 3) points."""
    pieces = [capsule(path[i], path[i + 1], radius) for i in range(len(path) - 1)]
    return Solid.batch_boolean(pieces, manifold3d.OpType.Add)


def outline(points: Points) -> manifold3d.CrossSection:
    """Return the plane region inside a closed polygon of (N, 2) points."""
    return manifold3d.CrossSection([np.ascontiguousarray(points, dtype=np.float64)])


def rounded(region: manifold3d.CrossSection, radius: float) -> manifold3d.CrossSection:
    """Round the corners of a plane region, outer and inner, by opening and closing it."""
    join = manifold3d.JoinType.Round
    opened = region.offset(-radius, join, 2.0, 16).offset(2.0 * radius, join, 2.0, 16)
    return opened.offset(-radius, join, 2.0, 16).simplify(radius * 0.02)
