"""Rest poses by statics: on which faces of its hull a body can lie, and how often it will."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.shapegen.mesh import Mesh, Points, face_normals

Quaternion = tuple[float, float, float, float]
"""A rotation as PyBullet writes it: x, y, z, w."""


@dataclass(frozen=True)
class RestPose:
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
