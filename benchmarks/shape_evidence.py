"""What a shape set is made of, near-duplicates in it, and whether its split is fair.

    python -m benchmarks.shape_evidence shapes/minitouch-1000

Quantities: mean, extremes and three quantiles, of all shapes and by family. Nearest: median and
least distance from a shape to its nearest, earth mover's between distance histograms.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from minitouch_bench.protocol.spec import Split
from minitouch_bench.shapegen.body_codec import Body
from minitouch_bench.shapegen.geometry import Points, face_normals
from minitouch_bench.shapegen.manifest import Shape, ShapeSet, load_shape_set
from minitouch_bench.shapegen.solids import Solid, to_mesh, to_solid

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
    differing = (turned - second).volume() + (second - turned).volume()
    return (both - differing) / (both + differing)


def held_out_of(shapes: Sequence[Shape]) -> NDArray[np.bool_] | None:
    """Return which shapes are held out, bool (N,); None where a split has too few to compare."""
    held = np.array([shape.split == Split.HELD_OUT for shape in shapes])
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


QUANTITIES: Mapping[str, Callable[[Shape], float]] = {
    "mass, g": lambda shape: shape.mass * 1000.0,
    "density, kg/m3": lambda shape: shape.density,
    "volume, cm3": lambda shape: shape.volume_m3 * 1e6,
    "longest side, mm": lambda shape: max(shape.extents) * 1000.0,
    "shortest side, mm": lambda shape: min(shape.extents) * 1000.0,
    "convexity": lambda shape: shape.convexity,
    "hulls": lambda shape: shape.hulls,
    "hull misfit": lambda shape: shape.misfit,
    "hull outside, mm": lambda shape: shape.outside_m * 1000.0,
    "stable poses": lambda shape: len(shape.poses),
    "grip trials lifted": lambda shape: shape.lifted,
}
"""Each quantity of the table, from a shape."""


BY_FAMILY = ("hulls", "convexity", "mass, g")
"""Quantities that are printed for each family as well."""


def stats_text(shapes: ShapeSet) -> str:
    """Measure a set and return its statistics as a plain table."""
    listed = shapes.shapes
    by_family = {
        family: [shape for shape in listed if shape.family == family]
        for family in sorted({shape.family for shape in listed})
    }
    lines = [f"{'quantity':20} {'of':10} {'mean':>9} {'min':>9} {'5 %':>9} {'median':>9} "
             f"{'95 %':>9} {'max':>9}"]  # fmt: skip
    lines += [_quantity_line(name, "all", listed) for name in QUANTITIES]
    for family, members in by_family.items():
        lines += [_quantity_line(name, family, members) for name in BY_FAMILY]
    lines += ["", f"{'family':20} {Split.TRAIN:>9} {Split.HELD_OUT:>9}"]
    for family, members in by_family.items():
        held = sum(shape.split == Split.HELD_OUT for shape in members)
        lines.append(f"{family:20} {len(members) - held:9d} {held:9d}")
    descriptors = np.array([descriptor(shape.body()) for shape in listed])
    lines += ["", f"{'nearest shape, mm':20} {'median':>9} {'least':>9}"]
    lines += _nearest_lines(listed, descriptors)
    lines += ["", "permutation test that train and held-out are one kind"]
    lines += _split_lines(listed, descriptors)
    return "\n".join(lines)


def _quantity_line(name: str, group: str, shapes: Sequence[Shape]) -> str:
    values = np.array([float(QUANTITIES[name](shape)) for shape in shapes])
    numbers = (values.mean(), *np.quantile(values, (0, 0.05, 0.5, 0.95, 1)))
    return f"{name:20} {group:10} " + " ".join(f"{number:9.3f}" for number in numbers)


def _nearest_lines(shapes: Sequence[Shape], descriptors: Points) -> Iterator[str]:
    if (held := held_out_of(shapes)) is None:
        return
    gaps = histogram_gaps(descriptors) * 1000.0
    np.fill_diagonal(gaps, np.inf)
    for name, rows in (("train to train", ~held), ("held-out to train", held)):
        least = gaps[np.ix_(rows, ~held)].min(axis=1)
        yield f"{name:20} {np.median(least):9.3f} {least.min():9.3f}"


def _split_lines(shapes: Sequence[Shape], descriptors: Points) -> Iterator[str]:
    """Test the set's split, and beside it splits that were biased on purpose."""
    if (held := held_out_of(shapes)) is None:
        return
    families = [shape.family for shape in shapes]
    convexity = np.array([shape.convexity for shape in shapes])
    mass = np.array([shape.mass for shape in shapes])
    splits = {"the set's split": held}
    for label, values in (("heavier", mass), ("more convex", convexity)):
        for bias in (0.25, 0.5, 1.0):
            splits[f"biased on purpose: {label}, strength {bias}"] = biased_split(
                values, families, bias, np.random.default_rng(0)
            )
    for name, labels in splits.items():
        p_value = split_p_value(descriptors, labels, families, np.random.default_rng(0))
        yield f"{name:40} p = {p_value:.4f}"


def main(folder: Path) -> None:
    """Print the statistics of a set and its near-duplicates; exit 1 if there are any."""
    shapes = load_shape_set(folder)
    print(stats_text(shapes))
    pairs = near_duplicates([shape.body() for shape in shapes.shapes])
    for pair in pairs:
        first, second = shapes.shapes[pair.first], shapes.shapes[pair.second]
        where = "within" if first.split == second.split else "across"
        print(f"{second.name} is like {first.name}, {where} the split (IoU {pair.iou:.3f})")
    sys.exit(bool(pairs))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
