import numpy as np
import pytest

from minitouch_bench.policies.scripted import make_controller
from minitouch_bench.protocol.spec import CameraSpec
from minitouch_bench.simulation.bodies import add_table
from minitouch_bench.simulation.client import View
from minitouch_bench.simulation.observation import (
    FORCES,
    OPENINGS,
    POSITION,
    GrayCamera,
    read_touch,
)
from minitouch_bench.tasks.environment import MiniTouchEnv


@pytest.fixture(scope="module")
def environment():
    made = MiniTouchEnv("playing")
    yield made
    made.close()


def test_what_is_read_is_the_arm_s_state(environment):
    environment.reset(seed=1)
    touch = read_touch(environment.arm, 50.0)
    assert touch.dtype == np.float32
    assert touch[POSITION] == pytest.approx(environment.arm.position)
    assert touch[OPENINGS].tolist() == [0.0, 0.0]
    environment.arm._place_joints([0.0, 0.5, 0.0, -1.5, 0.0, 2.0, 0.8])
    environment.client.set_joint(environment.arm.body, 9, 0.03)
    environment.client.set_joint(environment.arm.body, 10, 0.01)
    assert read_touch(environment.arm, 50.0)[OPENINGS] == pytest.approx([0.75, 0.25])


def test_a_press_is_felt_and_clipped(environment):
    environment.reset(seed=1)
    controller = make_controller(environment)
    forces = []
    for _ in range(15):
        environment.step(controller.act())
        forces.append(read_touch(environment.arm, 3.0)[FORCES])
    assert np.abs(forces).max() == 3.0
    environment.reset(seed=1)
    assert np.abs(read_touch(environment.arm, 50.0)[FORCES]).max() == 0.0


ABOVE = CameraSpec((0.5, 0.0, 0.0), yaw=0.0, pitch=-89.0, near=0.05, distance=0.7)


def scene(client):
    client.reset_world()
    table = add_table(client)
    thing = client.add_ghost_box((0.03,) * 3, (0.5, 0.0, 0.03), (0.2, 0.9, 0.1, 1.0))
    return table, thing


def test_the_picture_is_grey_with_the_weights_of_the_eye(client):
    table, _ = scene(client)
    rgb = client.render(View.of(ABOVE), 84, 84).rgb.astype(float)
    camera = GrayCamera(ABOVE)
    camera.keep_background(client, table, [])
    picture = camera.capture(client)
    assert (picture.shape, picture.dtype) == ((1, 84, 84), np.uint8)
    grey = rgb @ (0.2989, 0.5870, 0.1140)
    assert np.abs(picture[0] - grey).max() <= 0.6
