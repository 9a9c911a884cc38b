import math

import numpy as np
import pytest

from minitouch_bench.tasks.task import START_XY, Playing


@pytest.fixture
def environment(environments):
    return environments["playing"]


def test_two_hundred_layouts_keep_the_rules():
    task, rng, places = Playing(), np.random.default_rng(0), []
    for _ in range(200):
        task.draw(rng, None)
        places.append(task.position)
        assert math.dist(places[-1], START_XY) >= 0.07
    low, high = np.min(places, axis=0), np.max(places, axis=0)
    assert np.all(low >= (0.55, -0.15))
    assert np.all(high <= (0.70, 0.20))
    assert np.all(high - low > (0.13, 0.32))


def test_the_object_s_clearance_is_from_where_the_arm_starts(environment):
    environment.reset(seed=0)
    assert environment.arm.position[:2] == pytest.approx(START_XY, abs=5e-4)


def test_never_in_contact_at_the_start(environment):
    for seed in range(30):
        _, info = environment.reset(seed=seed)
        assert not environment.client.overlapping(
            environment.arm.body, environment.task.target_body, 0.005
        )
        assert info["object_state"][2] == pytest.approx(0.0025)


def test_nothing_but_the_step_limit_ends_it(environment):
    environment.reset(seed=1)
    environment.client.set_pose(environment.task.target_body, (0.9, 0.9, 0.5), (0, 0, 0, 1))
    _, reward, terminated, truncated, info = environment.step(np.zeros(4, np.float32))
    assert (reward, terminated, truncated, info["success"]) == (0.0, False, False, False)


def test_the_gripper_is_continuous(environment):
    environment.reset(seed=1)
    for _ in range(4):  # a step with a motion, so that it lasts
        environment.step(np.array((0, 0, 0.4, 0.2), np.float32))
    assert 0.3 < environment.step(np.zeros(4, np.float32))[0]["touch"][3] <= 1.0
