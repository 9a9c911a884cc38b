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
LEAST_SUCCESSES = {"pushing": 97, "opening": 99, "pick-up": 97}
"""Of 100 episodes."""
MOST_SUCCESSES_OF_A_FLOOR = 15
"""Random actions succeed in 11 of 100 Pushing episodes of table4."""


def episodes(task, count, floor=""):
    """Play episodes with the scripted policy, or with a floor in this process."""
    environment = MiniTouchEnv(task)
    policy = load_policy(parse_source(floor)) if floor else ScriptedPolicy(lambda _: environment)
    specs = [spec for spec in make_plan("table4").specs() if spec.task == task]
    records = [run_episode(environment, policy, spec) for spec in specs[:count]]
    environment.close()
    return records


def successes(records):
    return sum(record.outcome is Outcome.SUCCESS for record in records)


@pytest.mark.parametrize("task", TASK_CLASSES)
def test_actions_are_those_a_policy_could_give(task):
    environment = MiniTouchEnv(task, max_episode_steps=20)
    environment.reset(seed=1)
    controller, ticks = make_controller(environment), 0
    for _ in range(20):
        action = controller.act()
        assert action in environment.action_space
        *_, info = environment.step(action)
        assert not info["clipped"]
        assert info["action"].dtype == np.float32
        ticks += info["contact_ticks"]
    environment.close()
    assert task != "playing" or ticks > 100


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("task", TASK_CLASSES)
def test_a_hundred_episodes_of_each_task(task):
    records = episodes(task, 100)
    if task == "playing":
        assert np.mean([(one.trace.contact_ticks > 0).mean() for one in records]) >= TOUCH_SHARE
    else:
        assert successes(records) >= LEAST_SUCCESSES[task]


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("floor", ["random", "zero"])
@pytest.mark.parametrize("task", GOAL_TASKS)
def test_no_floor_solves_a_goal(floor, task):
    assert successes(episodes(task, 100, floor)) < MOST_SUCCESSES_OF_A_FLOOR
