"""The frame of a body: centre of mass at the origin, principal axes along x, y, z."""

import numpy as np

from minitouch_bench.shapegen.mesh import Mesh, Points, solid_moments

SAME = 1e-3
"""Moments closer than this share of the largest count as equal: their axes are free."""


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
        while stop < 3 and moments[stop] - moments[stop - 1] < SAME * moments[2]:
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
