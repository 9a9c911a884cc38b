"""PyBullet, imported without its line on stderr, and the small types that describe worlds."""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import UsageError
from minitouch_bench.machine import installed_versions
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import CameraSpec, Rgba


def _import_pybullet() -> Any:
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        import pybullet  # noqa: PLC0415  only here can the line be caught

        return pybullet
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)


pybullet: Any = _import_pybullet()

BUILDS = {"pybullet": "3.2.7", "pybullet-arm64": "3.2.8"}
"""Distributions of the protocol's simulator: the golden episodes are the same bits with both.

``pybullet`` has wheels for CPython 3.11, ``pybullet-arm64`` for later versions, also on x86-64.
"""


def _check_build() -> None:
    """Refuse another simulator than the protocol's, which gives other episodes.

    Raises:
        UsageError: another one is installed.
    """
    installed = installed_versions(BUILDS)
    if not installed.items() & BUILDS.items():
        here = " and ".join(f"{name} {number}" for name, number in installed.items())
        name = "pybullet" if sys.version_info < (3, 12) else "pybullet-arm64"
        raise UsageError(
            f"the protocol's simulator is {PROTOCOL.physics.simulator}, installed is "
            f"{here or 'another'}: pip install {name}=={BUILDS[name]}"
        )


_check_build()

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


@dataclass(frozen=True)
class View:
    """A camera: PyBullet's view and projection matrices (16 numbers each)."""

    view: tuple[float, ...]
    projection: tuple[float, ...]

    @classmethod
    def of(cls, camera: CameraSpec, aspect: float = 1.0) -> "View":
        """Return the matrices of a camera; z is up."""
        view = pybullet.computeViewMatrixFromYawPitchRoll(
            camera.target, camera.distance, camera.yaw, camera.pitch, 0.0, 2
        )
        projection = pybullet.computeProjectionMatrixFOV(
            camera.field_of_view, aspect, camera.near, camera.far
        )
        return cls(tuple(view), tuple(projection))


def quaternion_from_euler(angles: Vector) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of fixed-axis roll, pitch, yaw (rad)."""
    quaternion: tuple[float, float, float, float] = pybullet.getQuaternionFromEuler(angles)
    return quaternion
