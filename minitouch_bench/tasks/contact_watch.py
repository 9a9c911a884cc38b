"""Counting, tick by tick, when the fingers touch the task's object."""

from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_kinematics import FINGER_JOINTS


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
