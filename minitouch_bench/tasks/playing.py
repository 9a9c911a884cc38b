"""Playing: touch the cube. There is no goal; interaction is the metric."""

from typing import ClassVar

from minitouch_bench.episode import Outcome
from minitouch_bench.protocol.minitouch import PLAYING, TabletopSpec
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.tasks.task import TabletopTask


class Playing(TabletopTask):
    """A heavy cube at a random position."""

    spec: ClassVar[TabletopSpec] = PLAYING

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return None: only the step limit ends this task."""
        return None
