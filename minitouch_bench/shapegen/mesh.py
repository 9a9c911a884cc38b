"""Triangle meshes as plain arrays, and what follows from them by arithmetic alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

EQUAL_MOMENTS = 1e-3
"""Moments closer than this share of the largest count as equal: their axes are free."""


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: ``vertices`` float64 (V, 3) in m, ``faces`` int32 (F, 3), outward."""

    vertices: Points
    faces: NDArray[np.int32]

    @property
    def triangles(self) -> Points:
        """Corners of every face, float64 (F, 3, 3), m."""
        corners: Points = self.vertices[self.faces]
        return corners

    @property
    def extents(self) -> Points:
        """Sides of the axis-aligned box, float64 (3,), m."""
        sides: Points = np.ptp(self.vertices, axis=0)
        return sides

    def moved(self, rotation: Points, offset: Points) -> "Mesh":
        """Return the mesh with every vertex x at ``rotation @ x + offset``."""
        return Mesh(self.vertices @ rotation.T + offset, self.faces)


@dataclass(frozen=True)
class SolidMoments:
    """Volume (m³), centroid (3,) (m) and second moments (3, 3) (m⁵) about the centroid."""

    volume: float
    centroid: Points
    second: Points

    def inertia(self) -> Points:
        """Inertia tensor about the centroid at density 1 kg/m³, float64 (3, 3)."""
        tensor: Points = np.trace(self.second) * np.eye(3) - self.second
        return tensor


def solid_moments(mesh: Mesh) -> SolidMoments:
    """Integrate a closed mesh exactly, as signed tetrahedra against its first vertex."""
    origin = mesh.vertices[0]
    corners = mesh.triangles - origin
    six_volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    volume = six_volumes.sum() / 6.0
    sums = corners.sum(axis=1)
    centroid = six_volumes @ sums / 24.0 / volume
    second = np.einsum("f,fki,fkj->ij", six_volumes, corners, corners)
    second = (second + np.einsum("f,fi,fj->ij", six_volumes, sums, sums)) / 120.0
    second = second - volume * np.outer(centroid, centroid)
    return SolidMoments(float(volume), centroid + origin, second)


def in_body_frame(mesh: Mesh) -> Mesh:
    """Move a closed mesh into its body frame; x is the axis of least inertia."""
    moments = solid_moments(mesh)
    rotation = principal_axes(moments.inertia())
    return mesh.moved(rotation, -rotation @ moments.centroid)


def principal_axes(inertia: Points) -> Points:
    """Return a rotation (3, 3), axes as rows, that makes an inertia tensor diagonal.

    Where moments are equal the axes are chosen as near to the old x, y, z as they can be, so
    that a cube keeps its faces along the axes.
    """
    moments, vectors = np.linalg.eigh(inertia)
    rows: list[Points] = []
    start = 0
    while start < 3:
        stop = start + 1
        while stop < 3 and moments[stop] - moments[stop - 1] < EQUAL_MOMENTS * moments[2]:
            stop += 1
        rows += _nearest_basis(vectors[:, start:stop])
        start = stop
    axes = np.array(rows)
    signs = np.sign(axes[np.arange(3), np.abs(axes).argmax(axis=1)])
    axes *= signs[:, None]
    if np.linalg.det(axes) < 0:
        axes[2] *= -1.0
    return axes


def _nearest_basis(span: Points) -> list[Points]:
    """Return an orthonormal basis of a (3, k) span, one old axis projected after another."""
    basis: list[Points] = []
    projector = span @ span.T
    for _ in range(span.shape[1]):
        axis = int(np.linalg.norm(projector, axis=0).round(9).argmax())
        vector = projector[:, axis] / np.linalg.norm(projector[:, axis])
        basis.append(vector)
        projector = projector - np.outer(vector, vector)
    return basis


def face_normals(mesh: Mesh) -> tuple[Points, Points]:
    """Return unit normals (F, 3) and areas (F,) in m²; a face of no area has normal zero."""
    corners = mesh.triangles
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(lengths, 1e-300)[:, None]
    return normals, lengths / 2.0


def surface_points(mesh: Mesh, spacing: float) -> Points:
    """Return vertices and a regular lattice on every face, at most ``spacing`` m apart."""
    clouds = [mesh.vertices]
    corners = mesh.triangles
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    divisions = np.maximum(1, np.ceil(longest / spacing)).astype(int)
    for count in np.unique(divisions):
        steps = np.arange(count + 1)
        i, j = np.meshgrid(steps, steps, indexing="ij")
        inside = i + j <= count
        weights = np.stack([i, j, count - i - j], axis=-1)[inside] / count
        lattice = np.einsum("wk,fkd->fwd", weights, corners[divisions == count])
        clouds.append(lattice.reshape(-1, 3))
    return np.concatenate(clouds)


def distances_to_surface(points: Points, mesh: Mesh, block: int = 256) -> Points:
    """Return the distance in m from each of (N, 3) points to the nearest place on a mesh."""
    corners = mesh.triangles
    parts = [
        np.sqrt(_squared_distances(points[start : start + block], corners).min(axis=1))
        for start in range(0, len(points), block)
    ]
    return np.concatenate(parts) if parts else np.zeros(0)


def _squared_distances(points: Points, corners: Points) -> Points:
    """Squared distance of every point to every triangle: its plane inside, its edges outside."""
    best = np.full((len(points), len(corners)), np.inf)
    for k in range(3):
        start, edge = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        offset = points[:, None] - start
        length2 = np.maximum(np.einsum("fi,fi->f", edge, edge), 1e-300)
        along = np.clip(np.einsum("pfi,fi->pf", offset, edge) / length2, 0.0, 1.0)
        offset -= along[..., None] * edge
        np.minimum(best, np.einsum("pfi,pfi->pf", offset, offset), out=best)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    area2 = np.maximum(np.einsum("fi,fi->f", normal, normal), 1e-300)
    offset = points[:, None] - corners[:, 0]
    u = np.einsum("pfi,fi->pf", offset, np.cross(second, normal)) / area2
    v = np.einsum("pfi,fi->pf", offset, np.cross(normal, first)) / area2
    height2 = np.einsum("pfi,fi->pf", offset, normal) ** 2 / area2
    inside = (u >= 0) & (v >= 0) & (u + v <= 1)
    return np.where(inside, np.minimum(best, height2), best)


def first_hits(origins: Points, directions: Points, mesh: Mesh) -> tuple[Points, NDArray[np.int64]]:
    """Return distance (inf: none) and face of each ray's first hit, 1e-6 m or more away."""
    corners = mesh.triangles
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = np.cross(directions[:, None], second[None])
    determinant = np.einsum("fi,rfi->rf", first, cross)
    safe = np.where(np.abs(determinant) < 1e-18, np.inf, determinant)
    offset = origins[:, None] - corners[None, :, 0]
    u = np.einsum("rfi,rfi->rf", offset, cross) / safe
    other = np.cross(offset, first[None])
    v = np.einsum("ri,rfi->rf", directions, other) / safe
    distance = np.einsum("fi,rfi->rf", second, other) / safe
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 1e-6) & np.isfinite(safe)
    distance = np.where(hit, distance, np.inf)
    return distance.min(axis=1), distance.argmin(axis=1)


def thinnest_wall(mesh: Mesh) -> float:
    """Return the least distance in m through the solid between faces that look apart."""
    normals, areas = face_normals(mesh)
    real = areas > 1e-8
    centers = mesh.triangles.mean(axis=1)[real]
    distance, face = first_hits(centers, -normals[real], mesh)
    opposed = np.einsum("fi,fi->f", normals[real], normals[face]) < -0.7
    return float(distance[opposed].min()) if opposed.any() else float(mesh.extents.min())


def widest_across(points: Points) -> float:
    """Return the largest width in m of (N, 2) points over all directions in the plane."""
    angles = np.pi * np.arange(180) / 180.0
    along = points @ np.stack([np.cos(angles), np.sin(angles)])
    return float(np.ptp(along, axis=0).max())
