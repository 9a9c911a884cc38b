"""The small types that worlds are described in."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.protocol.spec import Rgba

Vector = Sequence[float]
Part = tuple[int, int]
"""A body and one of its links (-1 is the base)."""

INVISIBLE: Rgba = (1.0, 1.0, 1.0, 0.0)


class Pose(NamedTuple):
    """Position (m) and orientation (quaternion x, y, z, w) in the world."""

    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float]


class Contact(NamedTuple):
    """A contact point seen from the first body: the two links and the normal force (N)."""

    link_a: int
    link_b: int
    normal_force: float


class Image(NamedTuple):
    """A rendered picture: ``rgb`` uint8 (H, W, 3) and ``depth`` float32 (H, W), 1 = nothing.

    ``bodies`` int32 (H, W): the body seen at each pixel, -1 where there is none; None unless
    asked for.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    bodies: NDArray[np.int32] | None = None
