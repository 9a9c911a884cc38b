import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import CubeSpec
from minitouch_bench.protocol.spec import CameraSpec
from minitouch_bench.simulation import client as simulator
from minitouch_bench.simulation.bodies import add_table, cube_urdf
from minitouch_bench.simulation.client import INVISIBLE, PhysicsClient, View, quaternion_from_euler
from minitouch_bench.simulation.observation import seen_on_plane

RED = (1.0, 0.0, 0.0, 1.0)


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


def test_a_tick_is_a_240th_of_a_second(client):
    body = client.load_urdf(cube_urdf(CubeSpec(0.05, 0.3)), (0.0, 0.0, 10.0))
    for _ in range(24):
        client.step()
    linear, angular = client.speed(body)
    assert linear == pytest.approx(0.98, rel=0.01)
    assert angular == 0.0


def test_paint_hides_and_shows(client):
    body = client.add_ghost_box((0.2, 0.2, 0.2), (0, 0, 0), RED)
    view = View.of(CameraSpec((0.0, 0.0, 0.0), yaw=0.0, pitch=-60.0, near=0.1, distance=1.0))
    shown = client.render(view, 32, 24)
    assert (shown.rgb.shape, shown.depth.shape) == ((24, 32, 3), (24, 32))
    assert shown.depth.min() < 1.0
    client.paint({(body, -1): INVISIBLE})
    assert client.render(view, 32, 24).depth.min() == 1.0
    client.paint({(body, -1): RED})
    assert np.array_equal(client.render(view, 32, 24).rgb, shown.rgb)


def test_a_ghost_is_never_touched(client):
    ghost = client.add_ghost_box((0.1, 0.1, 0.1), (0, 0, 0), RED)
    body = client.load_urdf(cube_urdf(CubeSpec(0.05, 0.3)))
    client.step()
    assert client.contacts(ghost, body) == []
    assert not client.overlapping(ghost, body, 0.01)


@pytest.mark.parametrize(
    ("python", "build"),
    [((3, 11), "pybullet==3.2.7"), ((3, 13), "pybullet-arm64==3.2.8")],
)
def test_another_simulator_than_the_protocol_s_is_refused(monkeypatch, python, build):
    monkeypatch.setattr(simulator, "installed_versions", lambda _: {"pybullet": "3.2.6"})
    monkeypatch.setattr(simulator.sys, "version_info", python)
    with pytest.raises(UsageError, match=f"pip install {build}"):
        simulator._check_build()


def test_the_pixels_of_points_are_where_the_camera_sees_them():
    camera = CameraSpec((0.5, 0.1, 0.0), 30.0, -50.0, near=0.1)
    x, y = seen_on_plane(camera, 0.02, (60, 40))
    row, column = View.of(camera, aspect=1.5).pixels(x, y, 0.02, (60, 40))
    expected = np.indices((40, 60))
    np.testing.assert_array_equal((row, column), expected)
