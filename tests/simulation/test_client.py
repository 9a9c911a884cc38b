import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.spec import CameraSpec
from minitouch_bench.simulation.bodies import add_table
from minitouch_bench.simulation.client import PhysicsClient, pixels_of
from minitouch_bench.simulation.observation import seen_on_plane


def test_a_closed_world_is_not_used_again_though_another_has_its_number():
    first = PhysicsClient()
    number = first._bullet.id
    first.close()
    first.close()
    second = PhysicsClient()
    assert second._bullet.id == number
    table = add_table(second)
    for use in (
        first.reset_world,
        first.step,
        lambda: first.pose(table),
        lambda: first.link_position(table, 0),
        lambda: first.contacts(table, table),
        lambda: second.mirror(first),
    ):
        with pytest.raises(UsageError, match="closed"):
            use()
    assert second.pose(table).position
    second.close()


def test_the_pixels_of_points_are_where_the_camera_sees_them():
    camera = CameraSpec((0.5, 0.1, 0.0), 30.0, -50.0, near=0.1)
    x, y = seen_on_plane(camera, 0.02, (60, 40))
    row, column = pixels_of(camera, x, y, 0.02, (60, 40))
    expected = np.indices((40, 60))
    np.testing.assert_array_equal((row, column), expected)
