import numpy as np
import pytest

from minitouch_bench.policies.policy import action_size, load_policy
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.protocol.spec import fit_action


@pytest.mark.parametrize("name", ["random", "zero"])
@pytest.mark.parametrize("task", TASK_NAMES)
def test_actions_fit_the_task(name, task, observation):
    policy = load_policy(parse_source(name))
    policy.reset(1, task)
    action = fit_action(policy.act(observation), action_size(task))
    assert np.abs(action).max() <= 1.0


def test_random_actions_come_from_the_seed(observation):
    policy = load_policy(parse_source("random"))
    drawn = []
    for seed in (1, 1, 2):
        policy.reset(seed, "pushing")
        drawn.append(policy.act(observation).tolist())
    assert drawn[0] == drawn[1] != drawn[2]
