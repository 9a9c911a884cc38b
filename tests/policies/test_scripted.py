"""The scripted policy solves every task, and so each can be solved; floors solve none."""

import numpy as np
import pytest

from minitouch_bench.episode import Outcome
from minitouch_bench.evaluation.rollout import run_episode
from minitouch_bench.policies.policy import load_policy
from minitouch_bench.policies.scripted import ScriptedPolicy, make_controller
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import TASK_CLASSES

TOUCH_SHARE = 0.95
"""Least share of Playing's control steps in which the scripted policy touches the cube."""
LEAST_SUCCESS = {"pushing": 0.97, "opening": 0.99, "pick-up": 0.97}
MOST_SUCCESS_OF_A_FLOOR = 0.15
"""Random actions succeed in 0.11 of the Pushing episodes of table4."""


def episodes(task, count, floor=""):
    """Play episodes with the scripted policy, or with a floor in this process."""
    environment = MiniTouchEnv(task)
    policy = load_policy(parse_source(floor)) if floor else ScriptedPolicy(lambda _: environment)
    specs = [spec for spec in make_plan("table4").specs() if spec.task == task]
    records = [run_episode(environment, policy, spec) for spec in specs[:count]]
    environment.close()
    return records


def share(records, holds):
    return sum(map(holds, records)) / len(records)


def succeeds(record):
    return record.outcome is Outcome.SUCCESS


def touch_share(record):
    return (record.trace.contact_ticks > 0).mean()


@pytest.mark.parametrize("task", TASK_CLASSES)
def test_actions_are_those_a_policy_could_give(task):
    environment = MiniTouchEnv(task)
    environment.reset(seed=1)
    controller = make_controller(environment)
    for _ in range(8):
        action = controller.act()
        assert action in environment.action_space
        *_, info = environment.step(action)
        assert not info["clipped"]
        assert info["action"].dtype == np.float32
    environment.close()


def test_a_few_episodes_of_playing_are_full_of_touch():
    environment = MiniTouchEnv("playing", max_steps=20)
    for seed in range(4):
        environment.reset(seed=seed)
        controller = make_controller(environment)
        counts = [environment.step(controller.act())[4]["contact_ticks"] for _ in range(20)]
        assert sum(counts) > 100
    environment.close()


@pytest.mark.slow
@pytest.mark.parametrize("task", GOAL_TASKS)
def test_a_hundred_episodes_of_each_goal(task):
    assert share(episodes(task, 100), succeeds) >= LEAST_SUCCESS[task]


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_hundred_episodes_of_playing():
    shares = [touch_share(record) for record in episodes("playing", 100)]
    assert np.mean(shares) >= TOUCH_SHARE


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("floor", ["random", "zero"])
@pytest.mark.parametrize("task", GOAL_TASKS)
def test_no_floor_solves_a_goal(floor, task):
    assert share(episodes(task, 100, floor), succeeds) < MOST_SUCCESS_OF_A_FLOOR
