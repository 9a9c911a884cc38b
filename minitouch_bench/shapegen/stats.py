"""What a set is made of: counts, sizes, masses, hulls, likeness, and whether the split is fair."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from minitouch_bench.shapegen.likeness import (
    biased_split,
    descriptor,
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
    "rest poses": lambda shape: len(shape.poses),
    "grip trials lifted": lambda shape: shape.entry["lifted"],
}
"""Each quantity of the table, from a shape."""


@dataclass(frozen=True)
class Row:
    """One quantity over some shapes: mean, extremes and three quantiles."""

    name: str
    group: str
    mean: float
    quantiles: tuple[float, float, float, float, float]


@dataclass(frozen=True)
class SetStats:
    """The distribution of a set.

    ``families``: (train, held-out) counts. ``nearest``: median and least distance (mm, earth
    mover's between distance histograms) from a shape to its nearest, by "train to train" and
    "held-out to train". ``p_values``: permutation test of the split and of biased ones.
    """

    rows: tuple[Row, ...]
    families: dict[str, tuple[int, int]]
    nearest: dict[str, tuple[float, float]]
    p_values: dict[str, float]


def set_stats(shapes: ShapeSet) -> SetStats:
    """Measure a set.

    Raises:
        UsageError: a record is damaged.
    """
    listed = shapes.shapes
    rows = [_row(listed, name, "all") for name in QUANTITIES]
    families = sorted({shape.family for shape in listed})
    counts = {}
    for family in families:
        members = [shape for shape in listed if shape.family == family]
        rows += [_row(members, name, family) for name in ("hulls", "convexity", "mass, g")]
        held = sum(shape.split == HELD_OUT for shape in members)
        counts[family] = (len(members) - held, held)
    descriptors = np.array([descriptor(shape.body()) for shape in listed])
    return SetStats(
        tuple(rows), counts, _nearest(listed, descriptors), _p_values(listed, descriptors)
    )


def stats_text(stats: SetStats) -> str:
    """Return the statistics as a plain table."""
    lines = [f"{'quantity':20} {'of':10} {'mean':>9} {'min':>9} {'5 %':>9} {'median':>9} "
             f"{'95 %':>9} {'max':>9}"]  # fmt: skip
    for row in stats.rows:
        numbers = " ".join(f"{number:9.3f}" for number in (row.mean, *row.quantiles))
        lines.append(f"{row.name:20} {row.group:10} {numbers}")
    lines += ["", f"{'family':20} {TRAIN:>9} {HELD_OUT:>9}"]
    lines += [f"{name:20} {a:9d} {b:9d}" for name, (a, b) in stats.families.items()]
    lines += ["", f"{'nearest shape, mm':20} {'median':>9} {'least':>9}"]
    lines += [f"{name:20} {a:9.3f} {b:9.3f}" for name, (a, b) in stats.nearest.items()]
    lines += ["", "permutation test that train and held-out are one kind"]
    lines += [f"{name:40} p = {p:.4f}" for name, p in stats.p_values.items()]
    return "\n".join(lines)


def _row(shapes: Sequence[Shape], name: str, group: str) -> Row:
    values = np.array([float(QUANTITIES[name](shape)) for shape in shapes])
    low, five, median, ninety_five, high = np.quantile(values, (0, 0.05, 0.5, 0.95, 1)).tolist()
    return Row(name, group, float(values.mean()), (low, five, median, ninety_five, high))


def _nearest(shapes: Sequence[Shape], descriptors: Points) -> dict[str, tuple[float, float]]:
    gaps = histogram_gaps(descriptors) * 1000.0
    np.fill_diagonal(gaps, np.inf)
    held = np.array([shape.split == HELD_OUT for shape in shapes])
    if held.sum() < 2 or (~held).sum() < 2:
        return {}
    pairs = {"train to train": (~held, ~held), "held-out to train": (held, ~held)}
    found = {}
    for name, (rows, columns) in pairs.items():
        least = gaps[np.ix_(rows, columns)].min(axis=1)
        found[name] = (float(np.median(least)), float(least.min()))
    return found


def _p_values(shapes: Sequence[Shape], descriptors: Points) -> dict[str, float]:
    held = np.array([shape.split == HELD_OUT for shape in shapes])
    if held.sum() < 2 or (~held).sum() < 2:
        return {}
    families = [shape.family for shape in shapes]
    convexity = np.array([float(shape.entry["convexity"]) for shape in shapes])
    mass = np.array([shape.mass for shape in shapes])
    splits = {"the set's split": held}
    for label, values in (("heavier", mass), ("more convex", convexity)):
        for bias in (0.25, 0.5, 1.0):
            splits[f"biased on purpose: {label}, strength {bias}"] = biased_split(
                values, families, bias, np.random.default_rng(0)
            )
    return {
        name: split_p_value(descriptors, labels, families, np.random.default_rng(0))
        for name, labels in splits.items()
    }
