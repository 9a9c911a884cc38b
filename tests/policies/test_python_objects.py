from minitouch_bench.policies.policy import load_policy
from minitouch_bench.policies.sources import parse_source


def test_random_actions_come_from_the_seed(observation):
    policy = load_policy(parse_source("random"))
    drawn = []
    for seed in (1, 1, 2):
        policy.reset(seed, "pushing")
        drawn.append(policy.act(observation).tolist())
    assert drawn[0] == drawn[1] != drawn[2]
