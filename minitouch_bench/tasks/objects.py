"""The objects of the tasks: their own cubes and shapes of a set."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import CUBE, Split
from minitouch_bench.protocol.tasks import CubeSpec
from minitouch_bench.shapegen.manifest import (
    Shape,
    ShapeSet,
    canonical_shape_set,
)
from minitouch_bench.shapegen.mesh import Mesh, Quaternion, product, rotation_matrix
from minitouch_bench.simulation.bodies import cube_urdf
from minitouch_bench.simulation.client import PhysicsClient

Objects = str | Sequence[str] | Sequence[Shape] | ShapeSet
"""What an environment's objects can be named by."""

ALL = "all"
"""The name of every shape of the canonical set."""

_CUBE_FACES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
)  # fmt: skip


@dataclass(frozen=True)
class ObjectModel:
    """An object that can be loaded.

    ``rest``: a stable orientation (quaternion x, y, z, w), and ``rest_height`` the height
    of its center of mass (m) when it lies so. ``surface`` is its closed surface, and
    ``corners`` float64 (N, 3) those of its convex parts, about the center of mass (m).
    """

    name: str
    urdf: Path
    rest: Quaternion
    rest_height: float
    surface: Mesh
    corners: NDArray[np.float64]

    def load(self, client: PhysicsClient, x: float, y: float, yaw: float) -> int:
        """Add the object at a place on the table (m), turned by ``yaw`` (rad)."""
        return client.load_urdf(
            self.urdf,
            (x, y, PROTOCOL.physics.table_top + self.rest_height),
            product((0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)), self.rest),
            inertia_from_file=True,
        )

    def lowest_point(self, client: PhysicsClient, body: int) -> float:
        """Return the height of the lowest corner (m), without the collision margin."""
        return float(self._heights(client, body).min())

    def highest_point(self, client: PhysicsClient, body: int) -> float:
        """Return the height of the highest corner (m), without the collision margin."""
        return float(self._heights(client, body).max())

    def _heights(self, client: PhysicsClient, body: int) -> NDArray[np.float64]:
        position, orientation = client.pose(body)
        up = rotation_matrix(orientation)[2]
        heights: NDArray[np.float64] = position[2] + (self.corners * up).sum(axis=1)
        return heights


def cube_model(cube: CubeSpec) -> ObjectModel:
    """Return a task's own cube."""
    half = cube.side / 2
    signs = [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    corners = np.array(signs) * half
    surface = Mesh(corners, np.array(_CUBE_FACES, np.int32))
    return ObjectModel(CUBE, cube_urdf(cube), (0.0, 0.0, 0.0, 1.0), half, surface, corners)


class ObjectPool:
    """The objects an environment draws from, loaded when first used."""

    def __init__(self, names: tuple[str, ...], load: Callable[[str], ObjectModel]) -> None:
        self.names = names
        self.model = cache(load)
        """Returns the object of a name, which need not be one that is drawn, or a UsageError."""

    def draw(self, rng: np.random.Generator) -> ObjectModel:
        """Return one object, all equally likely."""
        return self.model(self.names[int(rng.integers(len(self.names)))])


def choose_shapes(chosen: Objects) -> tuple[Shape, ...]:
    """Return the shapes of a split, of a whole set, or those listed.

    Raises:
        UsageError: there is no such split or shape, or none is listed.
    """
    if isinstance(chosen, ShapeSet):
        return chosen.shapes
    canonical = canonical_shape_set()
    if isinstance(chosen, str):
        if chosen not in (ALL, *Split):
            known = ", ".join((CUBE, *Split, ALL))
            raise UsageError(f"no objects '{chosen}'; there are {known}, and lists of shapes")
        return canonical.shapes if chosen == ALL else canonical.split(chosen)
    if not isinstance(chosen, Sequence) or not chosen:
        raise UsageError(f"no objects {chosen!r}; give a name, a list of shapes, or a shape set")
    return tuple(item if isinstance(item, Shape) else canonical.by_name(item) for item in chosen)


def shape_model(shape: Shape) -> ObjectModel:
    """Return a shape as an object, lying as the first of its poses says."""
    body, pose = shape.body(), shape.poses[0]
    corners = np.concatenate([hull.vertices for hull in body.hulls])
    return ObjectModel(shape.name, shape.urdf, pose.quaternion, pose.height, body.visual, corners)
