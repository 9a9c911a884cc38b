"""The scripted policy solves every task, and so each can be solved."""

import numpy as np
import pytest

from minitouch_bench.episode import Outcome
from minitouch_bench.evaluation.rollout import run_episode
from minitouch_bench.policies.scripted import ScriptedPolicy, make_controller
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import TASK_CLASSES

TOUCH_SHARE = 0.95
"""Least share of Playing's control steps in which the scripted policy touches the cube."""
LEAST_SUCCESSES = {"pushing": 97, "opening": 99, "pick-up": 97}
"""Of 100 episodes."""


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
    environment = MiniTouchEnv(task)
    policy = ScriptedPolicy(lambda _: environment)
    specs = make_plan("table4", [task]).specs()
    records = [run_episode(environment, policy, spec) for spec in specs]
    environment.close()
    if task == "playing":
        assert np.mean([(one.trace.contact_ticks > 0).mean() for one in records]) >= TOUCH_SHARE
    else:
        outcomes = [record.outcome for record in records]
        assert outcomes.count(Outcome.SUCCESS) >= LEAST_SUCCESSES[task]
