"""What every scene shares: the table."""

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.simulation.client import PhysicsClient


def add_table(client: PhysicsClient) -> int:
    """Add the table and return its id."""
    physics = PROTOCOL.physics
    half = physics.table_half_extents
    return client.add_box(
        half,
        (*physics.table_center, physics.table_top - half[2]),
        PROTOCOL.observation.table_color,
        mass=0.0,
        friction=physics.table_friction,
    )
