"""The static grey camera, 84 x 84 pixels.

What never moves in an episode is drawn once, at the reset; each step draws only what moves
and lays it over that background by depth. The picture is the same as one drawn whole, and
costs a third: the software renderer's time goes into the pixels a table fills.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.simulation.client import PhysicsClient, View
from minitouch_bench.simulation.values import INVISIBLE, Image, Part

IMAGE_SIZE = 84
"""Width and height in pixels. Source: the paper's supplement."""

_RED, _GREEN, _BLUE = np.uint32(2989), np.uint32(5870), np.uint32(1140)
"""Ten-thousandths of each colour in grey (ITU-R BT.601). Source: the released package."""


@dataclass(frozen=True)
class CameraPreset:
    """Where a camera stands: looking at ``target`` (m), angles in degrees."""

    target: tuple[float, float, float]
    yaw: float
    pitch: float
    near: float
    distance: float = 0.7
    field_of_view: float = 60.0

    def view(self, aspect: float = 1.0) -> View:
        """Return the camera's matrices."""
        return View.orbit(
            self.target,
            distance=self.distance,
            yaw=self.yaw,
            pitch=self.pitch,
            fov=self.field_of_view,
            near=self.near,
            aspect=aspect,
        )


class GreyCamera:
    """A camera whose unmoving background is kept between pictures."""

    def __init__(self, preset: CameraPreset) -> None:
        self._view = preset.view()
        self._background = np.zeros((IMAGE_SIZE, IMAGE_SIZE), np.uint8)
        self._background_depth = np.ones((IMAGE_SIZE, IMAGE_SIZE), np.float32)

    def keep_background(self, client: PhysicsClient, still: Collection[Part]) -> None:
        """Take the picture of ``still`` alone as the background, and draw it no more."""
        colors = client.colors()
        moving = {part: color for part, color in colors.items() if part not in still}
        client.paint(dict.fromkeys(moving, INVISIBLE))
        image = client.render(self._view, IMAGE_SIZE, IMAGE_SIZE)
        client.paint(moving)
        client.paint(dict.fromkeys(still, INVISIBLE))
        self._background = _grey(image)
        self._background_depth = image.depth

    def capture(self, client: PhysicsClient) -> NDArray[np.uint8]:
        """Return the picture, uint8 (1, 84, 84): what is visible now, over the background."""
        image = client.render(self._view, IMAGE_SIZE, IMAGE_SIZE)
        hidden = image.depth >= self._background_depth
        return np.where(hidden, self._background, _grey(image))[np.newaxis]


def _grey(image: Image) -> NDArray[np.uint8]:
    # Integers, so that every processor rounds alike; in place, since this runs every step.
    total = image.rgb[..., 0] * _RED
    total += image.rgb[..., 1] * _GREEN
    total += image.rgb[..., 2] * _BLUE
    total += np.uint32(5000)
    total //= np.uint32(10000)
    return total.astype(np.uint8)
