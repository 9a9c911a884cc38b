"""The static gray camera, SIZE x SIZE pixels.

What never moves in an episode is drawn once, at the reset; each step draws only what moves
and lays it over that background by depth. The picture is the same as one drawn whole, and
costs a third: the software renderer's time goes into the pixels a table fills.

Shadows are discs on the table straight below what hovers over it, as from a lamp overhead:
the one cue of height that a camera without stereo has, for the price of a comparison a pixel.
"""

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import CameraSpec
from minitouch_bench.simulation.bullet import INVISIBLE, Image, Part, View
from minitouch_bench.simulation.client import PhysicsClient

OBSERVATION = PROTOCOL.observation
SIZE = OBSERVATION.image_size
_WEIGHTS = tuple(np.uint32(weight) for weight in OBSERVATION.grey_weights)


class Shadow(NamedTuple):
    """A disc on the table: center x, y and radius (m)."""

    x: float
    y: float
    radius: float


class GrayCamera:
    """A camera whose unmoving background is kept between pictures."""

    def __init__(self, camera: CameraSpec) -> None:
        self._view = View.of(camera)
        self._table_x, self._table_y = seen_on_plane(camera, PROTOCOL.physics.table_top)
        self._background = np.zeros(OBSERVATION.image_shape, np.uint8)
        self._background_depth = np.ones((SIZE, SIZE), np.float32)
        self._background_bodies = np.full((SIZE, SIZE), -1, np.int32)
        self._is_table = np.zeros((SIZE, SIZE), np.bool_)

    def keep_background(self, client: PhysicsClient, table: int, still: Collection[Part]) -> None:
        """Take the picture of the table and ``still`` alone as the background, from now on."""
        still = {(table, -1), *still}
        colors = client.colors()
        moving = {part: color for part, color in colors.items() if part not in still}
        client.paint(dict.fromkeys(moving, INVISIBLE))
        image = client.render(self._view, SIZE, SIZE, bodies=True)
        client.paint(moving)
        client.paint(dict.fromkeys(still, INVISIBLE))
        self._background = _pixels(image)
        self._background_depth = image.depth
        assert image.bodies is not None
        self._background_bodies = image.bodies
        self._is_table = image.bodies == table

    def visible_bodies(self, client: PhysicsClient) -> NDArray[np.int32]:
        """Return the body seen at each pixel, int32 (SIZE, SIZE)."""
        image = client.render(self._view, SIZE, SIZE, bodies=True)
        assert image.bodies is not None
        hidden = image.depth >= self._background_depth
        return np.where(hidden, self._background_bodies, image.bodies)

    def capture(self, client: PhysicsClient, shadows: Sequence[Shadow] = ()) -> NDArray[np.uint8]:
        """Return the image, uint8 (C, SIZE, SIZE): what is visible now, over the background."""
        image = client.render(self._view, SIZE, SIZE)
        hidden = image.depth >= self._background_depth
        return np.where(hidden, self._shaded(shadows), _pixels(image))

    def _shaded(self, shadows: Sequence[Shadow]) -> NDArray[np.uint8]:
        """Return the background with less light where the shadows fall."""
        background = self._background
        for shadow in shadows:
            across, along = self._table_x - shadow.x, self._table_y - shadow.y
            inside = across * across + along * along < shadow.radius * shadow.radius
            background = np.where(
                inside & self._is_table, self._background * OBSERVATION.shadow_light, background
            )
        return background.astype(np.uint8)


def _pixels(image: Image) -> NDArray[np.uint8]:
    if not _WEIGHTS:
        return image.rgb.transpose(2, 0, 1)
    red, green, blue = _WEIGHTS
    # Integers, so that every processor rounds alike; in place, since this runs every step.
    total = image.rgb[..., 0] * red
    total += image.rgb[..., 1] * green
    total += image.rgb[..., 2] * blue
    total += np.uint32(5000)
    total //= np.uint32(10000)
    return total.astype(np.uint8)[np.newaxis]


def seen_on_plane(
    camera: CameraSpec, height: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the x and y (m) where each pixel's ray meets z = ``height``, float64 (SIZE, SIZE)."""
    yaw, pitch = math.radians(camera.yaw), math.radians(camera.pitch)
    forward = (-math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch))
    right = (math.cos(yaw), math.sin(yaw), 0.0)
    up = (math.sin(yaw) * math.sin(pitch), -math.cos(yaw) * math.sin(pitch), math.cos(pitch))
    half = math.tan(math.radians(camera.field_of_view) / 2)
    steps = ((np.arange(SIZE) + 0.5) / SIZE * 2.0 - 1.0) * half
    across, upward = steps[np.newaxis, :], -steps[:, np.newaxis]
    rays = [forward[i] + across * right[i] + upward * up[i] for i in range(3)]
    eye = [camera.target[i] - camera.distance * forward[i] for i in range(3)]
    reach = (height - eye[2]) / rays[2]
    return eye[0] + reach * rays[0], eye[1] + reach * rays[1]
