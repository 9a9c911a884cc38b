import numpy as np
import pytest

from minitouch_bench.policies.scripted import make_controller
from minitouch_bench.simulation.observation import FORCES, OPENINGS, POSITION, read_touch
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
