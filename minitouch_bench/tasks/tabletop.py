"""What Playing, Pushing and Pick-up share: one object lying on the table."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.sensing.camera import CameraPreset
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_arm import START_XY
from minitouch_bench.simulation.scene import OBJECT_COLOR, Workspace
from minitouch_bench.tasks.objects import CUBE, ObjectModel

MARGIN_M = 0.05
"""Least distance of an object from the workspace's sides. Source: the released package."""
HAND_CLEARANCE_M = 0.07
"""Least distance of an object from the end effector's start: no episode begins in contact.
Ours."""


SETTLE_TICKS = 30
"""Shapes are laid down in a rest pose by statics; in this time the last 0.1 mm settle. Ours."""

TABLETOP_PORTRAIT = CameraPreset(
    (0.55, 0.0, 0.14), yaw=56.0, pitch=-24.0, near=0.05, distance=0.92, field_of_view=45.0
)
"""The view of ``render``, for people."""


@dataclass(frozen=True)
class Placement:
    """An object and where it lies: x, y (m) and yaw (rad)."""

    model: ObjectModel
    x: float
    y: float
    yaw: float

    def load(self, client: PhysicsClient) -> int:
        """Add the object, let it come to rest, and return its body's id."""
        body = self.model.load(client, self.x, self.y, self.yaw)
        client.paint({(body, -1): OBJECT_COLOR})
        if self.model.name != CUBE:
            for _ in range(SETTLE_TICKS):
                client.step()
        return body


def draw_yaw(rng: np.random.Generator, model: ObjectModel) -> float:
    """Return a random yaw (rad) for a shape; the tasks' own cubes lie square."""
    return 0.0 if model.name == CUBE else float(rng.uniform(0.0, 2.0 * math.pi))


def draw_placement(workspace: Workspace, rng: np.random.Generator, model: ObjectModel) -> Placement:
    """Draw a uniform place in the workspace less 5 cm that the hand does not cover."""
    while True:
        x, y = workspace.draw_place(rng, MARGIN_M)
        if math.dist((x, y), START_XY) >= HAND_CLEARANCE_M:
            return Placement(model, x, y, draw_yaw(rng, model))


def position_of(client: PhysicsClient, body: int) -> NDArray[np.float64]:
    """Return a body's centre of mass, float64 (3,) in m."""
    return np.array(client.pose(body).position)
