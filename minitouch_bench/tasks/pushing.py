"""Pushing: push the cube to the target, a gray cube that is seen and not touched."""

import math
from typing import ClassVar

import numpy as np

from minitouch_bench.episode import Outcome
from minitouch_bench.protocol.minitouch import PROTOCOL, PUSHING, PushingSpec
from minitouch_bench.simulation.client import Part, PhysicsClient
from minitouch_bench.simulation.panda_arm import PandaArm
from minitouch_bench.tasks.task import ObjectModel, TabletopTask, draw_position, draw_yaw

Position = tuple[float, float]


class Pushing(TabletopTask):
    """A heavy cube near its target."""

    spec: ClassVar[PushingSpec] = PUSHING

    target: Position
    """Where the object is to go: x, y (m)."""

    @property
    def visible_bodies(self) -> tuple[int, ...]:
        """The object and the target."""
        return self.target_body, self._marker

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw the target, the object around it, and the end effector around the object."""
        workspace = self.spec.workspace
        self.model = model or self.own_object()
        self.target = draw_position(workspace, rng, self.spec.target_margin)
        self.position = _draw_around(rng, self.target, self.spec.cube_distance)
        while not workspace.holds(*self._behind()):
            self.position = _draw_around(rng, self.target, self.spec.cube_distance)
        self._start = _draw_around(rng, self.position, self.spec.hand_distance)
        while not workspace.holds(*self._start):
            self._start = _draw_around(rng, self.position, self.spec.hand_distance)
        self.yaw = draw_yaw(rng, self.model)

    def add_scenery(self, client: PhysicsClient) -> tuple[Part, ...]:
        """Add the target."""
        half = self.spec.cube.side / 2
        height = PROTOCOL.physics.table_top + half
        color = PROTOCOL.observation.target_color
        self._marker = client.add_ghost_box((half,) * 3, (*self.target, height), color)
        return ((self._marker, -1),)

    def place_arm(self, arm: PandaArm) -> None:
        """Move the end effector to its start."""
        arm.place((*self._start, self.spec.start_height))

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return success near the target, a failure outside the workspace."""
        x, y, _ = client.pose(self.target_body).position
        if math.dist((x, y), self.target) < self.spec.success_distance:
            return Outcome.SUCCESS
        return None if self.spec.workspace.holds(x, y) else Outcome.LEFT_WORKSPACE

    def _behind(self) -> Position:
        """Return the position behind the object from which it is pushed to the target."""
        x, y = self.position
        scale = self.spec.push_clearance / math.dist(self.position, self.target)
        return x + scale * (x - self.target[0]), y + scale * (y - self.target[1])


def _draw_around(
    rng: np.random.Generator, center: Position, distances: tuple[float, float]
) -> Position:
    """Draw a position around another, uniform in angle and distance."""
    angle = rng.uniform(0.0, 2.0 * math.pi)
    distance = rng.uniform(*distances)
    return center[0] + distance * math.cos(angle), center[1] + distance * math.sin(angle)
