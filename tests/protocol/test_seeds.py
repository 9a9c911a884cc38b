import numpy as np
from gymnasium.utils.seeding import np_random

from minitouch_bench.evaluation.suites import find_suite
from minitouch_bench.protocol.seeds import episode_seed, policy_seed, senses_generator

KNOWN = {
    ("table4", "pushing", 0, 0): 3634405880,
    ("table4", "pushing", 1, 0): 4200078319,
    ("table4", "opening", 0, 0): 4193422061,
    ("smoke", "pushing", 0, 0): 24609413,
    ("table4", "pushing", 0, 1): 3276768529,
    ("table4", "pick-up", 99, 2**40): 834515736,
}
"""Pinned for good: another value would be another protocol."""


def test_known_seeds():
    assert {key: episode_seed(*key) for key in KNOWN} == KNOWN


def test_no_two_episodes_of_the_suites_share_a_seed():
    seeds = [
        spec.seed
        for name in ("table4", "smoke")
        for spec in find_suite(name).episodes(exploration=False)
    ]
    assert len(set(seeds)) == len(seeds)
    assert min(seeds) >= 0
    assert max(seeds) < 2**32


def test_the_world_the_policy_and_the_senses_share_no_stream():
    world, _ = np_random(3)
    generators = [
        world,
        np_random(3)[0].spawn(1)[0],  # from which the changed conditions are drawn
        np.random.default_rng(policy_seed(3)),
        senses_generator(3),
    ]
    first_numbers = [generator.random() for generator in generators]
    assert len(set(first_numbers)) == len(generators)
