"""What a set is made of: counts, sizes, masses, hulls, likeness, and whether the split is fair."""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from minitouch_bench.shapegen.likeness import (
    biased_split,
    descriptor,
    held_out_of,
    histogram_gaps,
    split_p_value,
)
from minitouch_bench.shapegen.manifest import HELD_OUT, TRAIN, Shape, ShapeSet
from minitouch_bench.shapegen.mesh import Points

QUANTITIES: Mapping[str, Callable[[Shape], float]] = {
    "mass, g": lambda shape: shape.mass * 1000.0,
    "density, kg/m3": lambda shape: shape.entry["density"],
    "volume, cm3": lambda shape: shape.entry["volume_m3"] * 1e6,
    "longest side, mm": lambda shape: max(shape.extents) * 1000.0,
    "shortest side, mm": lambda shape: min(shape.extents) * 1000.0,
    "convexity": lambda shape: shape.entry["convexity"],
    "hulls": lambda shape: shape.entry["hulls"],
    "hull misfit": lambda shape: shape.entry["misfit"],
    "hull outside, mm": lambda shape: shape.entry["outside_m"] * 1000.0,
    "stable poses": lambda shape: len(shape.poses),
    "grip trials lifted": lambda shape: shape.entry["lifted"],
}
"""Each quantity of the table, from a shape."""


BY_FAMILY = ("hulls", "convexity", "mass, g")
"""Quantities that are told of each family, too."""


def stats_text(shapes: ShapeSet) -> str:
    """Measure a set and return its statistics as a plain table.

    Quantities: mean, extremes and three quantiles, of all shapes and by family. Nearest: median
    and least distance from a shape to its nearest, earth mover's between distance histograms.

    Raises:
        UsageError: a record is damaged.
    """
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
    lines += ["", f"{'family':20} {TRAIN:>9} {HELD_OUT:>9}"]
    for family, members in by_family.items():
        held = sum(shape.split == HELD_OUT for shape in members)
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
    convexity = np.array([float(shape.entry["convexity"]) for shape in shapes])
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
