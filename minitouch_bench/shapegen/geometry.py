"""Triangle meshes as plain arrays, and what follows from them by arithmetic alone."""

from dataclasses import dataclass

import numpy as np
from msgspec import Struct
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
        return self.vertices[self.faces]

    @property
    def extents(self) -> Points:
        """Sides of the axis-aligned box, float64 (3,), m."""
        return np.ptp(self.vertices, axis=0)

    def moved(self, rotation: Points, offset: Points) -> "Mesh":
        """Return the mesh with every vertex x at ``rotation @ x + offset``."""
        return Mesh(self.vertices @ rotation.T + offset, self.faces)


@dataclass(frozen=True)
class SolidMoments:
    """Volume (m³), centroid (3,) (m) and inertia (3, 3) about it at a density of 1 kg/m³."""

    volume: float
    centroid: Points
    inertia: Points


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
    inertia = np.trace(second) * np.eye(3) - second
    return SolidMoments(float(volume), centroid + origin, inertia)


def in_body_frame(mesh: Mesh) -> Mesh:
    """Move a closed mesh into its body frame; x is the axis of least inertia."""
    moments = solid_moments(mesh)
    rotation = principal_axes(moments.inertia)
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


Quaternion = tuple[float, float, float, float]
"""A rotation as PyBullet writes it: x, y, z, w."""


class RestPose(Struct, frozen=True, rename={"height": "height_m"}):
    """A way to lie on a table: rotation, height of the center of mass (m), and share of drops."""

    quaternion: Quaternion
    height: float
    probability: float

    @property
    def rotation(self) -> Points:
        """The rotation as a matrix, float64 (3, 3)."""
        return rotation_matrix(self.quaternion)


SAME_DIRECTION = float(np.cos(0.05))
"""Faces turned down within 0.05 rad are one way to lie: halves of a square, facets of a curve."""


def rest_poses(hull: Mesh, least: float = 0.0) -> tuple[RestPose, ...]:
    """Return where a convex body comes to rest, likeliest first, above a ``least`` share.

    A random orientation lands on the face below the center of mass (solid angle), and rolls
    over the nearest edge until the center of mass stands above a face. The center is at 0.
    """
    normals, _ = face_normals(hull)
    heights = np.einsum("fi,fi->f", normals, hull.triangles[:, 0])
    following = _rolls_to(hull, normals, heights)
    for _ in range(12):  # each round doubles the steps of the walk
        following = following[following]
    shares = _solid_angles(hull) / (4.0 * np.pi)
    probability = np.bincount(following, shares, len(normals))
    kept: list[int] = []
    for face in np.argsort(-probability.round(9), kind="stable").tolist():
        same = [other for other in kept if normals[other] @ normals[face] > SAME_DIRECTION]
        if same:
            probability[same[0]] += probability[face]
        elif probability[face] > 0.0:
            kept.append(face)
    kept.sort(key=lambda face: -round(float(probability[face]), 9))
    return tuple(
        RestPose(quaternion_laying(normals[face]), float(heights[face]), float(probability[face]))
        for face in kept
        if probability[face] >= least
    )


def _solid_angles(hull: Mesh) -> Points:
    """Return the solid angle of every face seen from the origin (van Oosterom, Strackee)."""
    a, b, c = np.moveaxis(hull.triangles, 1, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    triple = np.abs(np.einsum("fi,fi->f", a, np.cross(b, c)))
    dots = (np.einsum("fi,fi->f", x, y) * lz for x, y, lz in ((a, b, lc), (b, c, la), (a, c, lb)))
    angles: Points = 2.0 * np.arctan2(triple, la * lb * lc + sum(dots))
    return np.abs(angles)


def _rolls_to(hull: Mesh, normals: Points, heights: Points) -> NDArray[np.int64]:
    """Return for each face the neighbor it tips onto, or itself where it is stable.

    A body only ever tips to a face on which its center of mass is no higher, up to rounding.
    """
    owner = {
        (int(a), int(b)): face
        for face, (i, j, k) in enumerate(hull.faces)
        for a, b in ((i, j), (j, k), (k, i))
    }
    foot = normals * heights[:, None]
    following = np.arange(len(hull.faces))
    for face, triangle in enumerate(hull.faces):
        worst = 0.0
        for a, b in zip(triangle, np.roll(triangle, -1), strict=True):
            edge = hull.vertices[b] - hull.vertices[a]
            inward = np.cross(normals[face], edge) / max(float(np.linalg.norm(edge)), 1e-12)
            beyond = -float(inward @ (foot[face] - hull.vertices[a]))
            neighbor = owner[(int(b), int(a))]
            if beyond > max(worst, 1e-9) and heights[neighbor] < heights[face] + 1e-7:
                worst, following[face] = beyond, neighbor
    return following


def quaternion_laying(direction: Points) -> Quaternion:
    """Return the shortest rotation that turns a unit direction straight down."""
    x, y, z = direction.tolist()
    if z > 1.0 - 1e-9:
        return (1.0, 0.0, 0.0, 0.0)
    # Half-way construction: the axis is direction x (0, 0, -1), the real part 1 + cos.
    quaternion = np.array([-y, x, 0.0, 1.0 - z])
    quaternion /= np.linalg.norm(quaternion)
    return tuple(quaternion.tolist())


def rotation_matrix(quaternion: Quaternion) -> Points:
    """Return the matrix (3, 3) of a unit quaternion (x, y, z, w)."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def product(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return the rotation ``first`` after ``second``."""
    ax, ay, az, aw = first
    bx, by, bz, bw = second
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def yaw(angle: float) -> Quaternion:
    """Return a rotation about the vertical by an angle in rad."""
    return (0.0, 0.0, float(np.sin(angle / 2.0)), float(np.cos(angle / 2.0)))
