"""The bridge between our meshes and manifold3d's solids, and every solid operation we use."""

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
    """Return a mesh of about ``faces`` faces (quadric edge collapse); smaller ones as they are.

    The result may be no manifold: the caller checks it.
    """
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
