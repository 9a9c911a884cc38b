"""How alike shapes are: a descriptor, near-duplicates, and whether two splits are one kind."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from minitouch_bench.shapegen.mesh import Mesh, Points, face_normals, solid_moments
from minitouch_bench.shapegen.record import Body
from minitouch_bench.shapegen.solids import to_solid

BIN, BINS = 0.0025, 48
"""Bins of the distance histogram, m: absolute, so that size counts; the last takes the rest."""
NEAR_DUPLICATE = 0.95
"""Shared share of the joint volume (IoU) from which two shapes are near-duplicates."""
SCREEN = 0.0009
"""Pairs whose histograms are farther apart than this (m, earth mover's) are not compared."""
SMALLEST_P = 0.01
"""A split is refused when the permutation test gives less."""


@dataclass(frozen=True)
class Pair:
    """Two shapes by position in the set, and their IoU after alignment."""

    first: int
    second: int
    iou: float


def descriptor(body: Body) -> Points:
    """Return the features of a body, float64 (54,): mass, volume, sides, and D2 by quadrature.

    D2, the share of pairs of surface points closer than d, is summed over all pairs of
    area-weighted points; a random sample of it could not tell a copy from a resampling.
    """
    moments = solid_moments(body.visual)
    sides = np.sort(body.visual.extents)
    points, weights = _quadrature(body.visual)
    squares = (points**2).sum(axis=1)
    gaps = np.sqrt(np.maximum(squares[:, None] + squares - 2.0 * points @ points.T, 0.0))
    bins = np.minimum((gaps / BIN).astype(np.int64), BINS - 1)
    histogram = np.bincount(bins.ravel(), np.outer(weights, weights).ravel(), BINS)
    numbers = [np.log(body.mass), np.log(moments.volume), *sides * 1000.0, len(body.hulls)]
    return np.concatenate([numbers, np.cumsum(histogram)])


def _quadrature(mesh: Mesh, spacing: float = 0.010) -> tuple[Points, Points]:
    """Return points on a mesh and weights by area, which sum to 1."""
    _, areas = face_normals(mesh)
    corners = mesh.triangles
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    counts = np.maximum(1, np.ceil(longest / spacing)).astype(int)
    points, weights = [], []
    for count in np.unique(counts):
        chosen = corners[counts == count]
        cells = _cell_centers(int(count))
        points.append(np.einsum("wk,fkd->fwd", cells, chosen).reshape(-1, 3))
        weights.append(np.repeat(areas[counts == count] / len(cells), len(cells)))
    joined = np.concatenate(weights)
    return np.concatenate(points), joined / joined.sum()


def _cell_centers(count: int) -> Points:
    """Return barycentric centers (count², 3) of a triangle cut into count² equal ones."""
    centers = []
    for i, j in product(range(count), repeat=2):
        if i + j < count:
            centers.append((i + 1 / 3, j + 1 / 3))
        if i + j < count - 1:
            centers.append((i + 2 / 3, j + 2 / 3))
    pairs = np.array(centers) / count
    return np.concatenate([pairs, 1.0 - pairs.sum(axis=1, keepdims=True)], axis=1)


def histogram_gaps(descriptors: Points) -> Points:
    """Return earth mover's distances (N, N) in m between the distance histograms."""
    cumulative = descriptors[:, 6:]
    return np.stack([np.abs(cumulative - row).sum(axis=1) * BIN for row in cumulative])


def near_duplicates(bodies: Sequence[Body], descriptors: Points) -> tuple[Pair, ...]:
    """Return the pairs of bodies that are nearly the same solid.

    Volumes bound the IoU from above and screen exactly; the histograms screen what is left.
    """
    gaps = histogram_gaps(descriptors)
    volumes = np.exp(descriptors[:, 1])
    found = []
    for first in range(len(bodies)):
        ratio = volumes[first] / volumes
        near = (gaps[first] < SCREEN) & (np.minimum(ratio, 1.0 / ratio) >= NEAR_DUPLICATE)
        for second in np.flatnonzero(near):
            if second > first:
                iou = aligned_iou(bodies[first].visual, bodies[int(second)].visual)
                if iou >= NEAR_DUPLICATE:
                    found.append(Pair(first, int(second), iou))
    return tuple(found)


def aligned_iou(first: Mesh, second: Mesh) -> float:
    """Return the best IoU of two solids in their body frames over the 24 turns of a cube."""
    solid = to_solid(first)
    best = 0.0
    for turn in np.rint(Rotation.create_group("O").as_matrix()):
        turned = second.moved(turn, np.zeros(3))
        if np.abs(turned.extents - first.extents).max() > 0.006:
            continue
        other = to_solid(turned)
        shared = float((solid ^ other).volume())
        best = max(best, shared / (float(solid.volume()) + float(other.volume()) - shared))
    return best


def split_p_value(
    descriptors: Points,
    held_out: NDArray[np.bool_],
    families: Sequence[str],
    rng: np.random.Generator,
    permutations_: int = 1999,
) -> float:
    """Return the p-value of a maximum mean discrepancy test that two splits are one kind.

    Labels are permuted within families, as the split itself was drawn. The kernel is Gaussian
    with the median distance as its width (Gretton et al. 2012) on standardized features.
    """
    spread = descriptors.std(axis=0)
    features = (descriptors - descriptors.mean(axis=0)) / np.where(spread > 0, spread, np.inf)
    # 32 strongly dependent bins of one histogram must not drown mass, volume and sides.
    features[:, 6:] /= np.sqrt(8.0)
    squares = (features**2).sum(axis=1)
    distances = np.maximum(squares[:, None] + squares - 2.0 * features @ features.T, 0.0)
    width = np.median(distances[~np.eye(len(distances), dtype=bool)])
    kernel = np.exp(-distances / max(float(width), 1e-12))
    labels = np.stack(
        [held_out, *(_permuted(held_out, families, rng) for _ in range(permutations_))]
    ).astype(np.float64)
    share = labels / labels.sum(axis=1, keepdims=True)
    rest = (1.0 - labels) / (1.0 - labels).sum(axis=1, keepdims=True)
    contrast = share - rest
    statistics = np.einsum("pi,pi->p", contrast @ kernel, contrast)
    return float((1 + (statistics[1:] >= statistics[0] - 1e-15).sum()) / (1 + permutations_))


def _permuted(
    held_out: NDArray[np.bool_], families: Sequence[str], rng: np.random.Generator
) -> NDArray[np.bool_]:
    names = np.array(families)
    shuffled = held_out.copy()
    for name in sorted(set(families)):
        members = np.flatnonzero(names == name)
        shuffled[members] = held_out[rng.permutation(members)]
    return shuffled


def biased_split(
    values: Points, families: Sequence[str], bias: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return a split that holds out a fifth of each family, tilted towards large ``values``.

    ``bias`` 0 is a fair draw, 1 holds out the largest.
    """
    names = np.array(families)
    held = np.zeros(len(names), dtype=bool)
    for name in sorted(set(families)):
        members = np.flatnonzero(names == name)
        ranks = np.argsort(np.argsort(values[members])) / len(members)
        score = bias * ranks + (1.0 - bias) * rng.random(len(members))
        held[members[np.argsort(-score)[: max(1, round(len(members) / 5))]]] = True
    return held
