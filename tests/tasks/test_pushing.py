import math

import numpy as np
import pytest

from minitouch_bench.episode import Outcome
from minitouch_bench.protocol.minitouch import PROTOCOL, PUSHING
from minitouch_bench.tasks.environment import OUTCOMES
from minitouch_bench.tasks.task import Pushing

TABLE_TOP_M, WORKSPACE = PROTOCOL.physics.table_top, PUSHING.workspace

STILL = np.zeros(4, np.float32)


@pytest.fixture
def environment(environments):
    return environments["pushing"]


def test_two_hundred_layouts_keep_the_rules():
    task, rng = Pushing(), np.random.default_rng(0)
    angles, targets = [], []
    for _ in range(200):
        task.draw(rng, None)
        target = np.array(task.target)
        place = np.array(task.position)
        start = np.array(task._start)
        away = (place - target) / math.dist(place, target)
        targets.append(target)
        for center, around in ((target, place), (place, start)):
            assert 0.10 <= math.dist(center, around) <= 0.20
            assert WORKSPACE.holds(*around)
        assert WORKSPACE.holds(*(place + 0.07 * away))
        assert task.yaw == 0.0
        angles.append(math.atan2(away[1], away[0]))
    low, high = np.min(targets, axis=0), np.max(targets, axis=0)
    assert np.all(low >= np.array(WORKSPACE.low[:2]) + 0.025)
    assert np.all(high <= np.array(WORKSPACE.high[:2]) - 0.025)
    assert np.all(high - low > 0.38)  # of 0.40 m
    assert np.histogram(angles, 8, (-math.pi, math.pi))[0].min() > 5  # from every side


def test_the_world_is_built_as_drawn_and_never_in_contact(environment):
    task = environment.task
    for seed in range(30):
        observation, info = environment.reset(seed=seed)
        wanted = (*task._start, 0.02)
        assert math.dist(environment.arm.position, wanted) < 1e-3
        assert np.allclose(observation["touch"][:3], environment.arm.position, atol=1e-6)
        assert np.allclose(info["object_state"][:2], task.position)
        assert not environment.client.overlapping(environment.arm.body, task.target_body, 0.005)
        assert not info["success"]


def put(environment, x, y):
    environment.client.set_pose(
        environment.task.target_body, (x, y, TABLE_TOP_M + 0.025), (0, 0, 0, 1)
    )


@pytest.mark.parametrize(("distance", "success"), [(0.0695, True), (0.0705, False)])
def test_success_is_seven_centimeters_from_the_target(environment, distance, success):
    environment.reset(seed=4)
    x, y = environment.task.target
    put(environment, x, y + distance)
    _, reward, terminated, truncated, info = environment.step(STILL)
    assert (terminated, truncated, info["success"]) == (success, False, success)
    assert reward == (25.0 if success else 0.0)
    assert OUTCOMES[info["outcome"]] is (Outcome.SUCCESS if success else None)


@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [
        (0.248, 0.0, False),
        (0.698, 0.2, True),
        (0.3, -0.202, False),
        (0.3, 0.248, True),
    ],
)
def test_an_object_outside_the_workspace_ends_the_episode_without_success(
    environment, x, y, inside
):
    environment.reset(seed=4)
    put(environment, x, y)
    _, reward, terminated, truncated, info = environment.step(STILL)
    assert (terminated, truncated) == (not inside, False)
    assert (reward, info["success"]) == (0.0, False)
    assert OUTCOMES[info["outcome"]] is (None if inside else Outcome.LEFT_WORKSPACE)


def test_the_target_is_seen_and_never_touched(environment):
    environment.reset(seed=4)
    x, y = environment.task.target
    environment.arm.place((x, y, 0.02))
    *_, info = environment.step(np.array((0, 0, 0.2, 0), np.float32))
    assert info["contact_ticks"] == 0
    assert info["ticks"] < 100
