"""Shapes of a set as objects of the tasks."""

from collections.abc import Sequence

import numpy as np

from minitouch_bench.shapegen.manifest import Shape, canonical_shape_set
from minitouch_bench.tasks.objects import ObjectModel, ObjectPool

ALL = "all"


def shape_pool(chosen: str | Sequence[str]) -> ObjectPool:
    """Return the shapes of a split of the canonical set, of all of it, or those named.

    Raises:
        UsageError: there is no such split or shape.
    """
    shapes = canonical_shape_set()
    if not isinstance(chosen, str):
        names = tuple(shapes.by_name(name).name for name in chosen)
    elif chosen == ALL:
        names = tuple(shape.name for shape in shapes.shapes)
    else:
        names = tuple(shape.name for shape in shapes.split(chosen))
    return ObjectPool(names, lambda name: shape_model(shapes.by_name(name)))


def shape_model(shape: Shape) -> ObjectModel:
    """Return a shape lying in its likeliest pose."""
    pose = shape.poses[0]
    body = shape.body()
    corners = np.concatenate([hull.vertices for hull in body.hulls])
    return ObjectModel(shape.name, shape.urdf, pose.quaternion, pose.height, body.visual, corners)
