import numpy as np
from gymnasium.utils.seeding import np_random

from minitouch_bench.protocol.minitouch import episode_seed, policy_seed, senses_generator
from minitouch_bench.runs.plan import make_plan

KNOWN = {
    ("table4", "pushing", 0, 0): 3634405880,
    ("table4", "pushing", 1, 0): 4200078319,
    ("table4", "opening", 0, 0): 4193422061,
    ("smoke", "pushing", 0, 0): 24609413,
    ("table4", "pushing", 0, 1): 3276768529,
    ("table4", "pick-up", 99, 2**40): 834515736,
}


def test_the_seeds_of_the_protocol_never_change():
    assert {key: episode_seed(*key) for key in KNOWN} == KNOWN
    assert policy_seed("table4", "pushing", 0, 0) == 2020787732168967154


def test_policy_seeds_have_64_bits_and_differ_wherever_a_word_differs():
    seeds = [spec.policy_seed for spec in make_plan("table4").specs()]
    seeds += [policy_seed(*key) for key in KNOWN if key[0] != "table4" or key[3]]
    assert len(set(seeds)) == len(seeds)
    assert 2**63 <= max(seeds) < 2**64


def test_the_search_that_found_the_scene_of_a_secret_run_finds_nothing():
    """Where the policy's seed was a function of the 32-bit episode seed, a search inverted it.

    Whatever seed of 32 bits is tried, an episode's own seed and the policy's are not among them.
    """
    secret = 2**255 + 3
    specs = make_plan("table4", seed=secret).specs()
    assert min(spec.seed for spec in specs).bit_length() > 64
    public = {spec.policy_seed for spec in make_plan("table4").specs()}
    assert not public & {spec.policy_seed for spec in specs}
    again = [spec.policy_seed for spec in make_plan("table4", seed=secret + 1).specs()]
    assert not set(again) & {spec.policy_seed for spec in specs}


def test_the_scene_the_policy_and_the_senses_share_no_stream():
    scene, _ = np_random(3)
    generators = [
        scene,
        np_random(3)[0].spawn(1)[0],  # from which the changed conditions are drawn
        np.random.default_rng(policy_seed("table4", "pushing", 0, 3)),
        senses_generator(3),
    ]
    first_numbers = [generator.random() for generator in generators]
    assert len(set(first_numbers)) == len(generators)
