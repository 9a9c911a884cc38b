"""The observation: a gray image and the touch vector; and contact, counted tick by tick.

What never moves in an episode is drawn once, at the reset; each step draws only what moves
and lays it over that background by depth. The image is the same as one drawn whole, and
costs a third: the software renderer's time goes into the pixels that a table fills.

Shadows are discs on the table straight below what hovers over it, as from a lamp overhead:
the one cue of height that a camera without stereo has, for the price of a comparison per pixel.
"""

import math
from collections.abc import Collection, Sequence

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import CameraSpec
from minitouch_bench.simulation.client import INVISIBLE, Image, Part, PhysicsClient
from minitouch_bench.simulation.panda_arm import FINGER_JOINTS, PandaArm

OBSERVATION = PROTOCOL.observation
POSITION, OPENINGS, FORCES = OBSERVATION.position, OBSERVATION.openings, OBSERVATION.forces
SENSED_TOUCH = {"touch": slice(None), "forces": FORCES}
"""Part of the touch vector that a sense of its own can be taken from."""


def read_touch(arm: PandaArm, force_limit: float) -> NDArray[np.float32]:
    """Return the touch vector, float32 (11,), forces clipped to ``force_limit`` (N)."""
    touch = np.empty(OBSERVATION.touch_size, np.float32)
    touch[POSITION] = arm.position
    # A squeezed finger reads a hair outside its joint's range.
    touch[OPENINGS] = np.clip(
        np.divide(arm.finger_positions(), PROTOCOL.control.finger_open), 0.0, 1.0
    )
    left, right = arm.finger_forces()
    touch[FORCES] = np.clip((*left, *right), -force_limit, force_limit)
    return touch


def observation_space(force_limit: float) -> spaces.Dict:
    """Return the space of observations with forces within ``force_limit`` (N)."""
    limits = np.ones(OBSERVATION.touch_size, np.float32)
    limits[POSITION], limits[FORCES] = OBSERVATION.position_limit, force_limit
    low = -limits
    low[OPENINGS] = 0.0
    return spaces.Dict(
        {
            "image": spaces.Box(0, 255, OBSERVATION.image_shape, np.uint8),
            "touch": spaces.Box(low, limits, dtype=np.float32),
        }
    )


class ContactWatch:
    """Contact between two fingers and some links of one body.

    A finger touches at a tick when one of its contact points carries a normal force > 0.
    Of the control step that ``begin_step`` began, ``ticks`` counts the ticks, ``contact_ticks``
    those with at least one touching finger, and ``onsets`` the times a finger began to touch.
    ``first_tick`` is the episode's first tick of contact, -1 if there was none.
    """

    def __init__(
        self, client: PhysicsClient, arm: int, target: int, target_links: tuple[int, ...]
    ) -> None:
        self._client = client
        self._arm = arm
        self._target = target
        self._links = frozenset(target_links)
        self._touching: frozenset[int] = frozenset()
        self._ticks_before = 0
        self.ticks = self.contact_ticks = self.onsets = 0
        self.first_tick = -1

    def begin_step(self) -> None:
        """Count from 0 again."""
        self._ticks_before += self.ticks
        self.ticks = self.contact_ticks = self.onsets = 0

    def after_tick(self) -> None:
        """Look at the contacts of the tick just done."""
        touching = frozenset(
            contact.link_a
            for contact in self._client.contacts(self._arm, self._target)
            if contact.normal_force > 0.0
            and contact.link_a in FINGER_JOINTS
            and contact.link_b in self._links
        )
        if touching:
            self.contact_ticks += 1
            self.onsets += len(touching - self._touching)
            if self.first_tick < 0:
                self.first_tick = self._ticks_before + self.ticks
        self._touching = touching
        self.ticks += 1


SIZE = OBSERVATION.image_size
_WEIGHTS = tuple(np.uint32(weight) for weight in OBSERVATION.grey_weights)


Shadow = tuple[float, float, float]
"""A disc on the table: center x, y and radius (m)."""


class GrayCamera:
    """A camera whose unmoving background is kept between pictures."""

    def __init__(self, camera: CameraSpec) -> None:
        self._camera = camera
        self._table_x, self._table_y = seen_on_plane(camera, PROTOCOL.physics.table_top)

    def keep_background(
        self, client: PhysicsClient, table: int, static_parts: Collection[Part]
    ) -> None:
        """Render the table and ``static_parts`` alone as the background from now on."""
        self._static = take_out(client, self._camera, (SIZE, SIZE), {(table, -1), *static_parts})
        self._background = _pixels(self._static)
        self._is_table = self._static.bodies == table

    def visible_bodies(self, client: PhysicsClient) -> NDArray[np.int32]:
        """Return the body seen at each pixel, int32 (SIZE, SIZE)."""
        image = client.render(self._camera, SIZE, SIZE, bodies=True)
        hidden = image.depth >= self._static.depth
        return np.where(hidden, self._static.bodies, image.bodies)

    def capture(self, client: PhysicsClient, shadows: Sequence[Shadow] = ()) -> NDArray[np.uint8]:
        """Return the image, uint8 (C, SIZE, SIZE): what is visible now, over the background."""
        image = client.render(self._camera, SIZE, SIZE)
        hidden = image.depth >= self._static.depth
        return np.where(hidden, self._shaded(shadows), _pixels(image))

    def _shaded(self, shadows: Sequence[Shadow]) -> NDArray[np.uint8]:
        """Return the background with less light where the shadows fall."""
        background = self._background
        for x, y, radius in shadows:
            across, along = self._table_x - x, self._table_y - y
            inside = across * across + along * along < radius * radius
            background = np.where(
                inside & self._is_table, self._background * OBSERVATION.shadow_light, background
            )
        return background.astype(np.uint8)


def take_out(
    client: PhysicsClient, camera: CameraSpec, size: tuple[int, int], static_parts: Collection[Part]
) -> Image:
    """Return an image of what never moves alone, ``size`` wide and high; it is drawn no more."""
    colors = client.colors()
    moving = {part: color for part, color in colors.items() if part not in static_parts}
    client.paint(dict.fromkeys(moving, INVISIBLE))
    image = client.render(camera, *size, bodies=True)
    client.paint(moving)
    client.paint(dict.fromkeys(static_parts, INVISIBLE))
    return image


def _pixels(image: Image) -> NDArray[np.uint8]:
    red, green, blue = _WEIGHTS
    # Integers, so that every processor rounds alike; in place, since this runs every step.
    total = image.rgb[..., 0] * red
    total += image.rgb[..., 1] * green
    total += image.rgb[..., 2] * blue
    total += np.uint32(5000)
    total //= np.uint32(10000)
    return total.astype(np.uint8)[np.newaxis]


def seen_on_plane(
    camera: CameraSpec, height: float, size: tuple[int, int] = (SIZE, SIZE)
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the x and y (m) where each pixel's ray meets z = ``height``, float64 (H, W).

    ``size``: width and height of the image in pixels.
    """
    yaw, pitch = math.radians(camera.yaw), math.radians(camera.pitch)
    forward = (-math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch))
    right = (math.cos(yaw), math.sin(yaw), 0.0)
    up = (math.sin(yaw) * math.sin(pitch), -math.cos(yaw) * math.sin(pitch), math.cos(pitch))
    half = math.tan(math.radians(camera.field_of_view) / 2)
    width, tall = (((np.arange(side) + 0.5) / side * 2.0 - 1.0) * half for side in size)
    across, upward = width[np.newaxis, :] * (size[0] / size[1]), -tall[:, np.newaxis]
    rays = [forward[i] + across * right[i] + upward * up[i] for i in range(3)]
    eye = [camera.target[i] - camera.distance * forward[i] for i in range(3)]
    reach = (height - eye[2]) / rays[2]
    return eye[0] + reach * rays[0], eye[1] + reach * rays[1]
