"""The observation: a gray picture and the touch vector; and contact, counted tick by tick."""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_arm import FINGER_JOINTS, PandaArm

POSITION = PROTOCOL.observation.position
OPENINGS = PROTOCOL.observation.openings
FORCES = PROTOCOL.observation.forces


def read_touch(arm: PandaArm, force_limit: float) -> NDArray[np.float32]:
    """Return the touch vector, float32 (11,), forces clipped to ``force_limit`` (N)."""
    touch = np.empty(PROTOCOL.observation.touch_size, np.float32)
    touch[POSITION] = arm.position
    # A squeezed finger reads a hair outside its joint's range.
    touch[OPENINGS] = np.clip(
        np.divide(arm.finger_positions(), PROTOCOL.control.finger_open), 0.0, 1.0
    )
    left, right = arm.finger_forces()
    touch[FORCES] = np.clip((*left, *right), -force_limit, force_limit)
    return touch


Observation = dict[str, NDArray[Any]]
"""``image``: uint8 (C, H, W); ``touch``: float32 (11,), see ``read_touch``."""


def observation_space(force_limit: float) -> spaces.Dict:
    """Return the space of observations with forces within ``force_limit`` (N)."""
    spec = PROTOCOL.observation
    low = np.empty(spec.touch_size, np.float32)
    high = np.empty(spec.touch_size, np.float32)
    low[POSITION], high[POSITION] = -spec.position_limit, spec.position_limit
    low[OPENINGS], high[OPENINGS] = 0.0, 1.0
    low[FORCES], high[FORCES] = -force_limit, force_limit
    return spaces.Dict(
        {
            "image": spaces.Box(0, 255, spec.image_shape, np.uint8),
            "touch": spaces.Box(low, high, dtype=np.float32),
        }
    )


class ContactWatch:
    """Contact between two fingers and some links of one body.

    A finger touches at a tick when one of its contact points carries a normal force > 0.
    ``contact_ticks`` counts ticks with at least one touching finger, ``onsets`` the times a
    finger began to touch; ``first_tick`` is the episode's first tick of contact, -1 if none.
    """

    def __init__(
        self, client: PhysicsClient, arm: int, target: int, target_links: tuple[int, ...]
    ) -> None:
        self._client = client
        self._arm = arm
        self._target = target
        self._links = frozenset(target_links)
        self._touching: frozenset[int] = frozenset()
        self._ticks = 0
        self.contact_ticks = 0
        self.onsets = 0
        self.first_tick = -1

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
                self.first_tick = self._ticks
        self._touching = touching
        self._ticks += 1
