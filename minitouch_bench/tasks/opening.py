"""Opening: find the handle of a cabinet and open its door."""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Outcome
from minitouch_bench.protocol.minitouch import OPENING, PROTOCOL, OpeningSpec
from minitouch_bench.simulation.bodies import DOOR_JOINT, DOOR_LINK, HANDLE_LINK, cabinet_urdf
from minitouch_bench.simulation.client import Part, PhysicsClient
from minitouch_bench.tasks.task import ObjectModel, Task


class Opening(Task):
    """A cabinet with one hinged door at a random position in reach."""

    spec: ClassVar[OpeningSpec] = OPENING
    target_links = (DOOR_LINK, HANDLE_LINK)

    position: tuple[float, float]
    """Where the cabinet stands: x of its front and y of its middle (m)."""

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw the position of the cabinet."""
        self.position = rng.uniform(*self.spec.front), rng.uniform(*self.spec.middle)

    def add_scenery(self, client: PhysicsClient) -> tuple[Part, ...]:
        """Add the cabinet; its body never moves."""
        cabinet = self.spec.cabinet
        floor = (*self.position, PROTOCOL.physics.table_top)
        self.target_body = client.load_urdf(cabinet_urdf(cabinet), floor, fixed=True)
        client.set_joint_friction(self.target_body, DOOR_JOINT, cabinet.hinge_friction)
        return ((self.target_body, -1),)

    def object_state(self, client: PhysicsClient) -> NDArray[np.float64]:
        """Return the door's angle, float64 (1,) in rad."""
        return np.array(client.joint_positions(self.target_body, [DOOR_JOINT]))

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return success at 30 degrees."""
        opened = self.object_state(client)[0] >= self.spec.success_angle
        return Outcome.SUCCESS if opened else None
