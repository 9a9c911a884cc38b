import math

import numpy as np
import pytest

from minitouch_bench.episode import Outcome
from minitouch_bench.protocol.minitouch import PICK_UP, PROTOCOL
from minitouch_bench.tasks.environment import OUTCOMES, MiniTouchEnv
from minitouch_bench.tasks.task import START_XY, PickUp

TABLE_TOP_M, WORKSPACE = PROTOCOL.physics.table_top, PICK_UP.workspace

STILL = np.zeros(4, np.float32)


@pytest.fixture(scope="module")
def with_cube():
    environment = MiniTouchEnv("pick-up", objects="cube")
    yield environment
    environment.close()


def test_two_hundred_layouts_keep_the_rules(environments):
    task, rng = PickUp(), np.random.default_rng(0)
    pool = environments["pick-up"]._pool
    yaws, names = [], set()
    for _ in range(200):
        model = pool.draw(rng)
        task.draw(rng, model)
        names.add(model.name)
        assert 0.55 <= task.position[0] <= 0.70
        assert -0.15 <= task.position[1] <= 0.15
        assert math.dist(task.position, START_XY) >= 0.09
        yaws.append(task.yaw)
    assert np.histogram(yaws, 8, (0.0, math.tau))[0].min() > 5
    assert len(names) > 1
    assert names <= set(pool.names)


def test_objects_lie_still_and_clear_of_the_hand(environments):
    environment = environments["pick-up"]
    for name in environment._pool.names[:6]:
        _, info = environment.reset(seed=3, options={"object": name})
        client, body = environment.client, environment.task.target_body
        assert not client.overlapping(environment.arm.body, body, 0.005)
        for _ in range(60):
            client.step()
        assert math.dist(info["object_state"], environment.task.object_state(client)) < 2e-3


@pytest.mark.parametrize(("height", "success"), [(0.049, False), (0.052, True)])
@pytest.mark.parametrize("tilt", [0.0, math.pi / 4])
def test_success_is_the_lowest_point_five_centimeters_up(with_cube, height, success, tilt):
    with_cube.reset(seed=1)
    lowest = 0.0225 * (math.cos(tilt) + math.sin(tilt))
    orientation = (math.sin(tilt / 2), 0.0, 0.0, math.cos(tilt / 2))
    place = (0.6, 0.0, TABLE_TOP_M + lowest + height)
    with_cube.client.set_pose(with_cube.task.target_body, place, orientation)
    _, reward, terminated, truncated, info = with_cube.step(STILL)
    assert (terminated, truncated, info["success"]) == (success, False, success)
    assert reward == (25.0 if success else 0.0)


def test_an_object_outside_the_workspace_ends_the_episode_without_success(with_cube):
    with_cube.reset(seed=1)
    outside = (WORKSPACE.low[0] - 0.002, 0.0, 0.0225)
    with_cube.client.set_pose(with_cube.task.target_body, outside, (0, 0, 0, 1))
    _, reward, terminated, _, info = with_cube.step(STILL)
    assert (reward, terminated) == (0.0, True)
    assert OUTCOMES[info["outcome"]] is Outcome.LEFT_WORKSPACE


def test_a_squeeze_is_felt_and_free_air_is_not(with_cube):
    environment = with_cube
    environment.reset(seed=1)
    rng, free = np.random.default_rng(0), []
    for _ in range(20):  # up, then about in the air
        action = rng.uniform(-1.0, 1.0, 4).astype(np.float32)
        action[2] = abs(action[2])
        free.append(environment.step(action)[0]["touch"][[6, 9]])
    assert np.abs(free).max() == 0.0
    x, y, _ = environment.client.pose(environment.task.target_body).position
    while math.dist(environment.arm.position, (x, y, 0.0)) > 0.003:
        hand = np.array(environment.arm.position)
        low = 0.0 if math.dist(hand[:2], (x, y)) < 0.003 else 0.06
        offset = np.clip((np.array((x, y, low)) - hand) / 0.06, -1.0, 1.0)
        environment.step(np.array((*offset, 1.0), np.float32))
    for step in range(4):
        action = np.array((0.0, 0.0, 0.05 * (-1) ** step, -1.0), np.float32)
        observation, *_ = environment.step(action)
    left, right = observation["touch"][[6, 9]]
    assert min(abs(left), abs(right)) > 15.0
    assert left * right < 0.0  # the fingers press against each other
