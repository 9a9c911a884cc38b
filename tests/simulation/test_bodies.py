import math

import pybullet
import pytest

from benchmarks.panda_meshes import write_panda, write_portrait
from minitouch_bench.protocol.minitouch import OPENING
from minitouch_bench.simulation.bodies import (
    DOOR_JOINT,
    DOOR_LINK,
    HANDLE_LINK,
    PANDA,
    PORTRAIT_PANDA,
    add_table,
)
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.tasks.task import Opening


@pytest.fixture
def client():
    made = PhysicsClient()
    add_table(made)
    return made


@pytest.fixture
def cabinet(client):
    task = Opening()
    task.position = (0.76, 0.0)
    task.add_scenery(client)
    return task.target_body


def angle_after_a_second(client, cabinet, torque):
    push = client._bullet.applyExternalTorque
    for _ in range(240):
        push(cabinet, DOOR_LINK, (0, 0, torque), pybullet.LINK_FRAME)
        client.step()
    return client.joint_positions(cabinet, [DOOR_JOINT])[0]


def test_the_hinge_gives_way_to_more_than_its_friction_until_the_door_s_range(client, cabinet):
    assert abs(angle_after_a_second(client, cabinet, 0.3)) < math.radians(0.1)
    assert angle_after_a_second(client, cabinet, 2.0) > math.radians(30.0)
    for _ in range(2):
        angle = angle_after_a_second(client, cabinet, 5.0)
    assert angle == pytest.approx(OPENING.cabinet.max_angle, abs=0.02)


def test_the_door_swings_free_of_its_body(client, cabinet):
    open_a_bit = math.radians(20.0)
    client.set_joint(cabinet, DOOR_JOINT, open_a_bit)
    assert angle_after_a_second(client, cabinet, 0.0) == pytest.approx(open_a_bit, abs=1e-3)


def test_the_door_weighs_and_measures_as_specified(client, cabinet):
    assert client._bullet.getDynamicsInfo(cabinet, DOOR_LINK)[0] == pytest.approx(2.64)
    low, high = client._bullet.getAABB(cabinet, DOOR_LINK)
    size = [top - bottom for bottom, top in zip(low, high, strict=True)]
    assert size == pytest.approx([0.021, 0.497, 0.835], abs=0.03)
    low, high = client._bullet.getAABB(cabinet, HANDLE_LINK)
    assert low[0] < 0.76 - 0.02
    assert low[2] < 0.10
    assert high[2] > 0.15


def test_the_committed_panda_is_made_from_the_installed_panda(tmp_path):
    for write, urdf in ((write_panda, PANDA), (write_portrait, PORTRAIT_PANDA)):
        committed = urdf.parent
        write(tmp_path / committed.name)
        made = {path.name: path.read_bytes() for path in (tmp_path / committed.name).iterdir()}
        assert made == {path.name: path.read_bytes() for path in committed.iterdir()}
