"""What a task is: its facts and the rules of its scene."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.protocol.spec import TaskSpec
from minitouch_bench.records import Outcome
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_arm import PandaArm
from minitouch_bench.simulation.values import Part
from minitouch_bench.tasks.objects import ObjectModel


class Task(ABC):
    """The scene, the object and the goal of one task.

    A reset calls ``draw``, ``add_scenery``, ``add_object`` and ``place_arm`` in this order; the
    same draws in the same order build the same world, bit for bit.
    """

    spec: ClassVar[TaskSpec]
    target_body: int
    """The body whose contact with the fingers counts as touch."""
    target_links: tuple[int, ...] = (-1,)
    """Its links that count (-1 is the base)."""

    @property
    def landmarks(self) -> tuple[int, ...]:
        """The bodies that the camera must see when an episode begins."""
        return (self.target_body,)

    @classmethod
    def own_object(cls) -> ObjectModel | None:
        """Return the task's own object, None where it has none to choose."""
        return None

    @abstractmethod
    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw where everything stands, with ``model`` in place of the task's own object."""

    def add_scenery(self, client: PhysicsClient) -> tuple[Part, ...]:
        """Add what stands beside the table, and return those of its parts that never move."""
        return ()

    def add_object(self, client: PhysicsClient) -> None:  # noqa: B027  Opening has none
        """Add the object, at rest."""

    def place_arm(self, arm: PandaArm) -> None:  # noqa: B027
        """Move the arm away from its start joints, where the task asks for it."""

    @abstractmethod
    def object_state(self, client: PhysicsClient) -> NDArray[np.float64]:
        """Return the object's position, float64 (3,) in m, or the door's angle, (1,) in rad."""

    @abstractmethod
    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return how the episode has just ended, None if it goes on."""
