"""Policies that lack the sense a task asks for must fail at it."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from minitouch_bench.policies.scripted import PushingController
from minitouch_bench.protocol.minitouch import PICK_UP, PUSHING
from minitouch_bench.tasks.environment import MiniTouchEnv

FIRST_SEED = 8_000_000
EPISODES = 60


def middle_of(workspace):
    """Return the middle of a workspace, x and y (m)."""
    x, y, _ = ((low + high) / 2 for low, high in zip(workspace.low, workspace.high, strict=True))
    return x, y


class BlindPusher(PushingController):
    """Push to the middle of the workspace, wherever the target is."""

    def __init__(self, environment):
        super().__init__(environment)
        task, center = self._task, middle_of(PUSHING.workspace)
        self._task = SimpleNamespace(target=center, model=task.model, target_body=task.target_body)


class CenterGrasper:
    """Close and lift at the middle of the workspace, wherever the object is."""

    def __init__(self, environment):
        self.environment, self.closing = environment, 0

    def act(self):
        hand = np.array(self.environment.arm.position)
        goal = np.array((*middle_of(PICK_UP.workspace), 0.0))
        offset = np.clip((goal - hand) / 0.06, -1.0, 1.0)
        if self.closing or np.abs(goal - hand).max() < 0.002:
            self.closing += 1
            lift = 0.05 * (-1) ** self.closing if self.closing < 5 else 0.5
            return np.array((0.0, 0.0, lift, -1.0), np.float32)
        return np.array((*offset, 1.0), np.float32)


def success_rate(task, make_policy):
    environment, successes = MiniTouchEnv(task), 0
    for seed in range(FIRST_SEED, FIRST_SEED + EPISODES):
        environment.reset(seed=seed)
        policy, ended = make_policy(environment), False
        while not ended:
            *_, terminated, truncated, info = environment.step(policy.act())
            ended = terminated or truncated
        successes += bool(info["success"])
    environment.close()
    return successes / EPISODES


@pytest.mark.slow
def test_a_pusher_that_never_looks_at_the_target_fails():
    assert success_rate("pushing", BlindPusher) <= 0.35


@pytest.mark.slow
def test_a_grasper_that_never_looks_for_the_object_fails():
    assert success_rate("pick-up", CenterGrasper) <= 0.10


def test_a_squeeze_is_felt_and_free_air_is_not():
    environment = MiniTouchEnv("pick-up", objects="cube")
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
    environment.close()
