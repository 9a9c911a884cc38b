"""What a task is, its facts and the rules of its scene; and what the three on the table share."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Outcome
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import CUBE, TaskSpec, Workspace
from minitouch_bench.protocol.tasks import TabletopSpec
from minitouch_bench.simulation.bullet import Part
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_arm import PandaArm
from minitouch_bench.tasks.objects import ObjectModel, cube_model

START_XY = (0.700, -0.029)
"""Where the end effector of ``POINTING_DOWN`` starts (m), at a height of 0.039 m."""


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
    def visible_bodies(self) -> tuple[int, ...]:
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

    def reward(self, client: PhysicsClient, outcome: Outcome | None) -> float:
        """Return the reward of the step that has just been done: sparse, if not overridden."""
        return self.spec.success_reward if outcome is Outcome.SUCCESS else 0.0


@dataclass(frozen=True)
class Placement:
    """An object and where it lies: x, y (m) and yaw (rad)."""

    model: ObjectModel
    x: float
    y: float
    yaw: float


class TabletopTask(Task):
    """A task with one object, at a random position on the table."""

    spec: ClassVar[TabletopSpec]
    _object: Placement

    @classmethod
    def own_object(cls) -> ObjectModel:
        """Return the task's cube."""
        return cube_model(cls.spec.cube)

    @property
    def model(self) -> ObjectModel:
        """The object of this episode."""
        return self._object.model

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw a uniform position in the workspace less a margin that the hand does not cover."""
        model = model or self.own_object()
        while True:
            x, y = draw_position(self.spec.workspace, rng, self.spec.margin)
            if math.dist((x, y), START_XY) >= self.spec.clearance:
                self._object = Placement(model, x, y, draw_yaw(rng, model))
                return

    def add_object(self, client: PhysicsClient) -> None:
        """Add the object and let it come to rest."""
        placed = self._object
        self.target_body = placed.model.load(client, placed.x, placed.y, placed.yaw)
        client.paint({(self.target_body, -1): PROTOCOL.observation.object_color})
        if placed.model.name != CUBE:
            for _ in range(self.spec.settle_ticks):
                client.step()

    def object_state(self, client: PhysicsClient) -> NDArray[np.float64]:
        """Return the object's center of mass, float64 (3,) in m."""
        return np.array(client.pose(self.target_body).position)


def draw_position(
    workspace: Workspace, rng: np.random.Generator, margin: float
) -> tuple[float, float]:
    """Return a uniform position (m) at least ``margin`` from the four sides."""
    x = rng.uniform(workspace.low[0] + margin, workspace.high[0] - margin)
    y = rng.uniform(workspace.low[1] + margin, workspace.high[1] - margin)
    return float(x), float(y)


def draw_yaw(rng: np.random.Generator, model: ObjectModel) -> float:
    """Return a random yaw (rad) for a shape; the tasks' own cubes lie square."""
    return 0.0 if model.name == CUBE else float(rng.uniform(0.0, 2.0 * math.pi))
