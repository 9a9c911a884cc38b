import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import CubeSpec
from minitouch_bench.protocol.spec import CameraSpec
from minitouch_bench.simulation import client as simulator
from minitouch_bench.simulation.bodies import add_table, cube_urdf
from minitouch_bench.simulation.client import PhysicsClient, View, quaternion_from_euler
from minitouch_bench.simulation.observation import seen_on_plane


def drop(client):
    """Let a tilted cube fall onto the table; return where it comes to lie."""
    client.reset_world()
    add_table(client)
    body = client.load_urdf(
        cube_urdf(CubeSpec(0.05, 0.3)), (0.5, 0, 0.2), quaternion_from_euler((0.3, 0.2, 0))
    )
    for _ in range(240):
        client.step()
    return client.pose(body)


def test_a_world_built_anew_gives_the_same_bits(client):
    first = drop(client)
    other = PhysicsClient()
    assert drop(other) == first == drop(client)
    other.close()


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


def test_a_world_that_nothing_uses_is_freed():
    client = PhysicsClient()
    number = client._bullet.id
    del client
    assert not simulator.pybullet.isConnected(number)


def test_the_pixels_of_points_are_where_the_camera_sees_them():
    camera = CameraSpec((0.5, 0.1, 0.0), 30.0, -50.0, near=0.1)
    x, y = seen_on_plane(camera, 0.02, (60, 40))
    row, column = View.of(camera, aspect=1.5).pixels(x, y, 0.02, (60, 40))
    expected = np.indices((40, 60))
    np.testing.assert_array_equal((row, column), expected)
