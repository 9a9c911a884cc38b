"""Peg: set a peg down on a plate."""

import math
from typing import ClassVar

import numpy as np

from minitouch_bench.episode import Outcome
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.tasks import PEG, PegSpec
from minitouch_bench.simulation.bullet import Part
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.tasks.objects import ObjectModel
from minitouch_bench.tasks.task import TabletopTask, draw_position


class Peg(TabletopTask):
    """A light peg, and a plate that lies on the table."""

    spec: ClassVar[PegSpec] = PEG

    @property
    def plate(self) -> tuple[float, float]:
        """Where the middle of the plate is: x, y (m)."""
        return self._plate

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw the peg, and the plate apart from it."""
        super().draw(rng, model)
        self._plate = draw_position(self.spec.workspace, rng, self.spec.margin)
        while math.dist(self._plate, (self._object.x, self._object.y)) < self.spec.apart:
            self._plate = draw_position(self.spec.workspace, rng, self.spec.margin)

    def add_scenery(self, client: PhysicsClient) -> tuple[Part, ...]:
        """Add the plate."""
        half = (self.spec.plate_side / 2, self.spec.plate_side / 2, self.spec.plate_height / 2)
        height = PROTOCOL.physics.table_top + half[2]
        color = PROTOCOL.observation.target_color
        plate = client.add_box(half, (*self._plate, height), color, friction=1.0)
        return ((plate, -1),)

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return success where the peg stands on the plate, a failure outside the workspace."""
        x, y, _ = client.pose(self.target_body).position
        top = PROTOCOL.physics.table_top + self.spec.plate_height
        height = self.model.lowest_point(client, self.target_body) - top
        if abs(height) < 0.004 and math.dist((x, y), self._plate) < self.spec.plate_side / 2:
            return Outcome.SUCCESS
        return None if self.spec.workspace.holds(x, y) else Outcome.LEFT_WORKSPACE
