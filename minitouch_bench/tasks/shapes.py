"""Shapes of a set as objects of the tasks."""

from collections.abc import Sequence

import numpy as np

from minitouch_bench.shapegen.manifest import ShapeSet, canonical_shape_set
from minitouch_bench.shapegen.poses import rotation_matrix
from minitouch_bench.tasks.objects import ObjectModel

ALL = "all"


def shape_names(chosen: str | Sequence[str]) -> tuple[str, ...]:
    """Return the names of the shapes of a split, of the whole set, or of those listed.

    Raises:
        UsageError: there is no such split or shape.
    """
    shapes = canonical_shape_set()
    if not isinstance(chosen, str):
        return tuple(shapes.by_name(name).name for name in chosen)
    found = shapes.shapes if chosen == ALL else shapes.split(chosen)
    return tuple(shape.name for shape in found)


def shape_model(name: str, stands: float, shapes: ShapeSet | None = None) -> ObjectModel:
    """Return a shape, by default of the canonical set.

    It lies in its likeliest pose that is ``stands`` (m) high, else in its highest: the pads,
    kept 17 mm above the table, must have enough to hold.

    Raises:
        UsageError: there is no such shape.
    """
    shape = (shapes or canonical_shape_set()).by_name(name)
    body = shape.body()
    corners = np.concatenate([hull.vertices for hull in body.hulls])
    heights = [float(np.ptp(corners @ rotation_matrix(p.quaternion)[2])) for p in shape.poses]
    high = [index for index, height in enumerate(heights) if height >= stands]
    pose = shape.poses[high[0] if high else int(np.argmax(heights))]
    return ObjectModel(name, shape.urdf, pose.quaternion, pose.height, body.visual, corners)
