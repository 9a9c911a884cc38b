import math

import numpy as np
import pytest

from minitouch_bench.protocol.minitouch import OPENING
from minitouch_bench.simulation.bodies import DOOR_JOINT
from minitouch_bench.tasks.task import Opening

CABINET, WORKSPACE = OPENING.cabinet, OPENING.workspace

STILL = np.zeros(5, np.float32)


@pytest.fixture
def environment(environments):
    return environments["opening"]


def handle_position(front, middle, angle):
    """Return x, y (m) of the bar's middle with the door at ``angle`` (rad)."""
    outward = CABINET.door_thickness / 2 + CABINET.handle_thickness / 2
    hinge_x, hinge_y = front + CABINET.door_thickness / 2, middle + CABINET.hinge_y
    sine, cosine = math.sin(angle), math.cos(angle)
    x = hinge_x - CABINET.handle_radius * sine - outward * cosine
    y = hinge_y + CABINET.handle_radius * cosine - outward * sine
    return x, y


def test_two_hundred_placements_put_the_shut_handle_in_reach():
    task, rng, places = Opening(), np.random.default_rng(0), []
    for _ in range(200):
        task.draw(rng, None)
        places.append(task.position)
        x, y = handle_position(*task.position, 0.0)
        assert WORKSPACE.low[0] <= x - CABINET.handle_thickness / 2 <= WORKSPACE.high[0]
        assert WORKSPACE.low[1] <= y <= WORKSPACE.high[1]
    assert np.ptp(places, axis=0) == pytest.approx((0.005, 0.22), rel=0.1)


def test_the_handle_is_where_the_cabinet_says(environment):
    environment.reset(seed=1)
    task, client = environment.task, environment.client
    for degrees in (0.0, 15.0, 40.0):
        client.set_joint(task.target_body, DOOR_JOINT, math.radians(degrees))
        x, y, _ = client.placed_link_position(task.target_body, 1)
        expected = handle_position(*task.position, math.radians(degrees))
        assert (x, y) == pytest.approx(expected, abs=1e-6)


def test_never_in_contact_and_always_shut_at_the_start(environment):
    for seed in range(30):
        _, info = environment.reset(seed=seed)
        assert info["object_state"].tolist() == [0.0]
        assert not environment.client.overlapping(
            environment.arm.body, environment.task.target_body, 0.005
        )


@pytest.mark.parametrize(("degrees", "success"), [(29.9, False), (30.1, True)])
def test_success_is_thirty_degrees(environment, degrees, success):
    environment.reset(seed=1)
    body = environment.task.target_body
    environment.client.set_joint(body, DOOR_JOINT, math.radians(degrees))
    _, reward, terminated, truncated, info = environment.step(STILL)
    assert (terminated, truncated, info["success"]) == (success, False, success)
    assert reward == (25.0 if success else 0.0)


def test_the_yaw_stays_within_45_degrees(environment):
    environment.reset(seed=1)
    arm = environment.arm
    yaws = []
    for _ in range(5):
        environment.step(np.array((0, 0, 0.1, 0, -1), np.float32))
        yaws.append(arm.yaw)
    assert yaws == pytest.approx([-0.3, -0.6] + [-math.pi / 4] * 3)
    for _ in range(8):
        environment.step(np.array((0, 0, 0.1, 0, 1), np.float32))
        assert -math.pi / 4 <= arm.yaw <= math.pi / 4
    assert arm.yaw > 0.0


@pytest.mark.parametrize("task", ["opening", "pick-up"])
def test_the_gripper_is_open_or_closed(environments, task):
    environment = environments[task]
    environment.reset(seed=1)
    arm = environment.arm
    size = environment.action_space.shape[0]
    openings = []
    assert arm.gripper_opening == 1.0
    environment.step(np.array([0.0, 0.0, 0.5, -1.0, 0.0], np.float32)[:size])
    for value in (0.2, 0.2, 0.1, -0.1, -0.2, -1.0, 1.0):
        action = np.zeros(size, np.float32)
        # Up and down in turn: a step lasts as long as its motion.
        action[2:4] = (0.5 if len(openings) % 2 else -0.5, value)
        environment.step(action)
        openings.append(arm.gripper_opening)
    step = 0.075 / 0.04
    expected = [0.2 * step, 0.4 * step, 0.5 * step, 0.4 * step, 0.2 * step, 0.0, 1.0]
    assert openings == pytest.approx(expected, abs=1e-6)
    assert arm._finger_targets(0.0) == [0.04, 0.04]
    assert arm._finger_targets(-0.2) == [0.04, 0.04]
    assert arm._finger_targets(-0.1) == [0.0, 0.0]
