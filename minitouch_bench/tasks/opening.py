"""Opening: find the handle of a cabinet and open its door."""

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.records import Outcome
from minitouch_bench.sensing.camera import CameraPreset
from minitouch_bench.simulation.bodies import (
    DOOR_JOINT,
    DOOR_LINK,
    HANDLE_LINK,
    Cabinet,
    cabinet_urdf,
)
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_arm import FACING_DOOR
from minitouch_bench.simulation.scene import TABLE_TOP_M, Workspace
from minitouch_bench.simulation.values import Part
from minitouch_bench.tasks.objects import ObjectModel
from minitouch_bench.tasks.task import Task, TaskPreset

SUCCESS_ANGLE_RAD = math.radians(30.0)
"""Source: text (the release has 33 degrees)."""
FRONT_M = (0.70, 0.705)
"""Range of the door's outer face, x. Ours: from the closed door to 30 degrees the fingers
can then stand beside the handle inside the workspace."""
MIDDLE_M = (-0.05, 0.10)
"""Range of the cabinet's middle, y. Ours."""
CABINET = Cabinet()
WORKSPACE = Workspace((0.5, -0.20, 0.10), (0.75, 0.20, 0.15))


class Opening(Task):
    """A cabinet with one hinged door at a random place in reach."""

    preset: ClassVar[TaskPreset] = TaskPreset(
        name="opening",
        goal="door open by 30 degrees",
        workspace=WORKSPACE,
        camera=CameraPreset((0.625, 0.0, 0.05), yaw=0.0, pitch=-90.0, near=0.01),
        portrait=CameraPreset(
            (0.58, -0.05, 0.28),
            yaw=-62.0,
            pitch=-24.0,
            near=0.05,
            distance=1.45,
            field_of_view=45.0,
        ),
        arm=FACING_DOOR,
        default_objects="",
        shadows=False,
    )
    target_links = (DOOR_LINK, HANDLE_LINK)

    @property
    def place(self) -> tuple[float, float]:
        """Where the cabinet stands: x of its front and y of its middle (m)."""
        return self._place

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw the place of the cabinet."""
        self._place = float(rng.uniform(*FRONT_M)), float(rng.uniform(*MIDDLE_M))

    def add_scenery(self, client: PhysicsClient) -> tuple[Part, ...]:
        """Add the cabinet; its body never moves."""
        self.target_body = client.load_urdf(
            cabinet_urdf(CABINET), (*self._place, TABLE_TOP_M), fixed=True
        )
        client.set_joint_friction(self.target_body, DOOR_JOINT, CABINET.hinge_friction)
        return ((self.target_body, -1),)

    def object_state(self, client: PhysicsClient) -> NDArray[np.float64]:
        """Return the door's angle, float64 (1,) in rad."""
        return np.array(client.joint_positions(self.target_body, [DOOR_JOINT]))

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return success at 30 degrees."""
        opened = self.object_state(client)[0] >= SUCCESS_ANGLE_RAD
        return Outcome.SUCCESS if opened else None
