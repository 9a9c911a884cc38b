"""What every scene shares: the workspace, the table, and colours."""

from dataclasses import dataclass

import numpy as np

from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.values import Rgba

TABLE_HALF_EXTENTS = (1.0, 1.0, 0.05)
TABLE_TOP_M = -0.025
TABLE_CENTER = (0.5, 0.0, TABLE_TOP_M - 0.05)
TABLE_FRICTION = 1.0
"""As the table of ``pybullet_data``, which the released package uses."""

TABLE_COLOR: Rgba = (0.85, 0.73, 0.58, 1.0)
TARGET_COLOR: Rgba = (0.48, 0.48, 0.48, 1.0)
OBJECT_COLOR: Rgba = (0.30, 0.12, 0.10, 1.0)


@dataclass(frozen=True)
class Workspace:
    """The box in which the end effector moves (m)."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @property
    def center(self) -> tuple[float, float, float]:
        """Centre of the box (m)."""
        x, y, z = ((low + high) / 2 for low, high in zip(self.low, self.high, strict=True))
        return x, y, z

    def holds(self, x: float, y: float) -> bool:
        """Tell whether a place on the table lies inside, looking from above."""
        return self.low[0] <= x <= self.high[0] and self.low[1] <= y <= self.high[1]

    def draw_place(self, rng: np.random.Generator, margin: float) -> tuple[float, float]:
        """Return a uniform place (m) at least ``margin`` from the four sides."""
        x = rng.uniform(self.low[0] + margin, self.high[0] - margin)
        y = rng.uniform(self.low[1] + margin, self.high[1] - margin)
        return float(x), float(y)


def add_table(client: PhysicsClient) -> int:
    """Add the table, its top at z = 0, and return its id."""
    return client.add_box(
        TABLE_HALF_EXTENTS, TABLE_CENTER, TABLE_COLOR, mass=0.0, friction=TABLE_FRICTION
    )
