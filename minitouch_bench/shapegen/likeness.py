"""How alike shapes are: a descriptor, near-duplicates, and whether two splits are one kind."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from minitouch_bench.shapegen.manifest import HELD_OUT, Shape
from minitouch_bench.shapegen.mesh import Points, face_normals
from minitouch_bench.shapegen.record import Body
from minitouch_bench.shapegen.solids import Solid, symmetric_difference, to_mesh, to_solid

BIN, BINS = 0.0025, 48
"""Bins of the distance histogram, m: absolute, so that size counts; the last takes the rest."""
SPACING = 0.010
"""Longest edge of the triangles that a distance histogram is summed over, m."""
CELLS, CELL = 16, 0.00825
"""Number of grid cells along each axis and their side, m: all that a record can hold is inside."""
RAYS = np.stack([np.arange(16), np.arange(16) * 7 % 16], axis=1) / 16 + 1 / 32
"""Where the rays pass through a cell, (16, 2) of its side: at 16 levels of x and of y."""
NEAR_DUPLICATE = 0.95
"""Shared share of the joint volume (IoU) from which two shapes are near-duplicates."""
SLACK = 0.06
"""What the rays may make a bound of the IoU too low by: 0.029 was the most in 5,000 trials."""
TURNS = np.rint(Rotation.create_group("O").as_matrix())
"""The 24 turns of a cube as matrices, float64 (24, 3, 3)."""
SMALLEST_P = 0.01
"""A split is refused when the permutation test gives less."""


@dataclass(frozen=True)
class Pair:
    """Two shapes by position in the set, and their IoU after alignment."""

    first: int
    second: int
    iou: float


def descriptor(body: Body) -> Points:
    """Return the features of a body, float64 (54,): mass, volume, sides, hulls, and cumulative D2.

    D2, the share of pairs of surface points closer than d, is summed over all pairs of
    area-weighted points; a random sample of it could not tell a copy from a resampling.
    """
    solid = to_solid(body.visual)
    fine = to_mesh(solid.refine_to_length(SPACING))
    points, areas = fine.triangles.mean(axis=1), face_normals(fine)[1]
    bins = np.minimum(cdist(points, points) / BIN, BINS - 1).astype(np.intp)
    pairs = np.outer(areas, areas) / areas.sum() ** 2
    histogram = np.bincount(bins.ravel(), pairs.ravel(), BINS)
    sides = np.sort(body.visual.extents) * 1000.0
    numbers = [np.log(body.mass), np.log(solid.volume()), *sides, len(body.hulls)]
    return np.concatenate([numbers, np.cumsum(histogram)])


def histogram_gaps(descriptors: Points) -> Points:
    """Return earth mover's distances (N, N) in m between the distance histograms."""
    gaps: Points = cdist(descriptors[:, 6:], descriptors[:, 6:], "cityblock") * BIN
    return gaps


def near_duplicates(bodies: Sequence[Body]) -> tuple[Pair, ...]:
    """Return the pairs of bodies that are nearly the same solid in one of the 24 turns of a cube.

    Two solids differ at least by the volumes by which they fill each cell of a grid differently.
    This bounds the IoU from above, and only what it leaves is intersected.
    """
    solids = [to_solid(body.visual) for body in bodies]
    volumes = np.array([solid.volume() for solid in solids])
    filled = [cell_fills(solid) for solid in solids]
    flat = np.array([fills.ravel() for fills in filled])
    pairs = []
    for first, solid in enumerate(solids):
        ratio = volumes[first] / volumes
        near = np.flatnonzero(np.minimum(ratio, 1.0 / ratio) >= NEAR_DUPLICATE)
        near = near[near > first]
        turned = np.array([_turned(filled[first], turn).ravel() for turn in TURNS])
        differing = cdist(turned, flat[near], "cityblock")
        both = volumes[first] + volumes[near]
        possible = (both - differing) / (both + differing) >= NEAR_DUPLICATE - SLACK
        for column in np.flatnonzero(possible.any(axis=0)):
            second = int(near[column])
            iou = max(_iou(solid, turn, solids[second]) for turn in TURNS[possible[:, column]])
            if iou >= NEAR_DUPLICATE:
                pairs.append(Pair(first, second, iou))
    return tuple(pairs)


def cell_fills(solid: Solid) -> Points:
    """Return a solid's volume (m³) per cell, float64 (CELLS,) * 3, by ``RAYS`` along z."""
    floors = CELL * (np.arange(CELLS) - CELLS / 2)
    low, high = np.array(solid.bounding_box()).reshape(2, 3)
    heights = np.zeros((CELLS, CELLS, CELLS))
    for i, j in np.ndindex(CELLS, CELLS):
        for x, y in np.array([floors[i], floors[j]]) + CELL * RAYS:
            if low[0] < x < high[0] and low[1] < y < high[1]:
                for hit in solid.ray_cast([x, y, floors[0]], [x, y, -floors[0]]):
                    below = np.clip(hit.position[2] - floors, 0.0, CELL)
                    heights[i, j] += np.sign(hit.normal[2]) * below
    return heights * CELL**2 / len(RAYS)


def _turned(fills: Points, turn: Points) -> Points:
    """Return the fills of a solid after a turn (3, 3) of the cube."""
    axes = np.abs(turn).argmax(axis=1)
    mirrored = np.flatnonzero(turn[range(3), axes] < 0)
    return np.flip(fills.transpose(axes), tuple(mirrored.tolist()))


def _iou(first: Solid, turn: Points, second: Solid) -> float:
    """Return the shared share of the joint volume of two solids, the first one turned."""
    turned = first.transform(np.hstack([turn, np.zeros((3, 1))]))
    both = float(turned.volume() + second.volume())
    differing = symmetric_difference(turned, second)
    return (both - differing) / (both + differing)


def held_out_of(shapes: Sequence[Shape]) -> NDArray[np.bool_] | None:
    """Return which shapes are held out, bool (N,); None where a split has too few to compare."""
    held = np.array([shape.split == HELD_OUT for shape in shapes])
    return held if min(held.sum(), (~held).sum()) >= 2 else None


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
    # The strongly dependent bins of one histogram must not drown mass, volume and sides.
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
    """Return a held-out fifth of each family; ``bias`` 0 is fair, 1 takes large ``values``."""
    names = np.array(families)
    held = np.zeros(len(names), dtype=bool)
    for name in sorted(set(families)):
        members = np.flatnonzero(names == name)
        ranks = np.argsort(np.argsort(values[members])) / len(members)
        score = bias * ranks + (1.0 - bias) * rng.random(len(members))
        held[members[np.argsort(-score)[: max(1, round(len(members) / 5))]]] = True
    return held
