"""Pick-up: grasp an object of a shape set and lift it."""

from typing import ClassVar

from minitouch_bench.episode import Outcome
from minitouch_bench.protocol.minitouch import PICK_UP, PROTOCOL, PickUpSpec
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.tasks.task import TabletopTask


class PickUp(TabletopTask):
    """An object of a shape set, lying still."""

    spec: ClassVar[PickUpSpec] = PICK_UP

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return success at 5 cm above the table, a failure outside the workspace."""
        lowest = self.model.lowest_point(client, self.target_body)
        if lowest - PROTOCOL.physics.table_top >= self.spec.lift:
            return Outcome.SUCCESS
        x, y, _ = client.pose(self.target_body).position
        return None if self.spec.workspace.holds(x, y) else Outcome.LEFT_WORKSPACE
