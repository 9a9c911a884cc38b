"""Playing: touch the cube. There is no goal; interaction is the metric."""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.records import Outcome
from minitouch_bench.sensing.camera import CameraPreset
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_arm import POINTING_DOWN
from minitouch_bench.simulation.scene import Workspace
from minitouch_bench.tasks.objects import ObjectModel, cube_model
from minitouch_bench.tasks.tabletop import TABLETOP_PORTRAIT, draw_placement, position_of
from minitouch_bench.tasks.task import Task, TaskPreset

# Constants of the released package.
CUBE_SIDE_M = 0.055
CUBE_MASS_KG = 50.0
CUBE_FRICTION = 1.0
WORKSPACE = Workspace((0.5, -0.20, 0.0), (0.75, 0.25, 0.10))


class Playing(Task):
    """A heavy cube at a random place."""

    preset: ClassVar[TaskPreset] = TaskPreset(
        name="playing",
        goal="none: touch is the metric",
        workspace=WORKSPACE,
        camera=CameraPreset((0.625, 0.025, -0.2), yaw=90.0, pitch=-60.0, near=0.26),
        portrait=TABLETOP_PORTRAIT,
        arm=POINTING_DOWN,
    )

    @staticmethod
    def own_object() -> ObjectModel:
        """Return the task's cube."""
        return cube_model(CUBE_SIDE_M, CUBE_MASS_KG, CUBE_FRICTION)

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw the place of the object."""
        self._object = draw_placement(WORKSPACE, rng, model or self.own_object())

    def add_object(self, client: PhysicsClient) -> None:
        """Add the object."""
        self.target_body = self._object.load(client)

    def object_state(self, client: PhysicsClient) -> NDArray[np.float64]:
        """Return the object's position, float64 (3,) in m."""
        return position_of(client, self.target_body)

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return None: only the step limit ends this task."""
        return None
