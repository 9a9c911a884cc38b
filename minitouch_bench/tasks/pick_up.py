"""Pick-up: grasp an object of a shape set and lift it."""

from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.records import Outcome
from minitouch_bench.sensing.camera import CameraPreset
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_arm import POINTING_DOWN
from minitouch_bench.simulation.scene import TABLE_TOP_M, Workspace
from minitouch_bench.tasks.objects import ObjectModel, cube_model
from minitouch_bench.tasks.tabletop import TABLETOP_PORTRAIT, draw_placement, position_of
from minitouch_bench.tasks.task import Task, TaskPreset

LIFT_M = 0.05
"""Height of the object's lowest point at success. Source: text (the release: its centre at
7.5 cm)."""
FINGER_FORCES = (60.0, 60.0)
"""In N, the real gripper's range. Ours: the release's 350 and 400 N belong to its 10 kg
objects and squeeze out anything of a sensible mass."""
FORCE_LIMIT = 200.0
"""Bound of the touch vector's forces (N). Source: the released package."""
CUBE_SIDE_M = 0.045
CUBE_MASS_KG = 0.2
CUBE_FRICTION = 1.0
"""The task's own cube, used only on request. Ours."""
WORKSPACE = Workspace((0.5, -0.20, 0.0), (0.75, 0.20, 0.15))


class PickUp(Task):
    """An object of a shape set, lying still."""

    preset: ClassVar[TaskPreset] = TaskPreset(
        name="pick-up",
        goal="object 5 cm above the table",
        workspace=WORKSPACE,
        camera=CameraPreset((0.625, 0.0, -0.2), yaw=90.0, pitch=-60.0, near=0.26),
        portrait=TABLETOP_PORTRAIT,
        arm=replace(POINTING_DOWN, finger_forces=FINGER_FORCES, discrete_gripper=True),
        force_limit=FORCE_LIMIT,
        default_objects="train",
    )

    @staticmethod
    def own_object() -> ObjectModel:
        """Return a cube that can be lifted."""
        return cube_model(CUBE_SIDE_M, CUBE_MASS_KG, CUBE_FRICTION)

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw the place and the yaw of the object."""
        self._object = draw_placement(WORKSPACE, rng, model or self.own_object())

    @property
    def model(self) -> ObjectModel:
        """The object of this episode."""
        return self._object.model

    def add_object(self, client: PhysicsClient) -> None:
        """Add the object and let it come to rest."""
        self.target_body = self._object.load(client)

    def object_state(self, client: PhysicsClient) -> NDArray[np.float64]:
        """Return the object's position, float64 (3,) in m."""
        return position_of(client, self.target_body)

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return success at 5 cm above the table, a failure outside the workspace."""
        if self._object.model.lowest_point(client, self.target_body) >= TABLE_TOP_M + LIFT_M:
            return Outcome.SUCCESS
        x, y, _ = client.pose(self.target_body).position
        return None if WORKSPACE.holds(x, y) else Outcome.LEFT_WORKSPACE
