"""Seeds of episodes: a function of what the episode is, and of nothing else."""

import hashlib

import numpy as np

from minitouch_bench.protocol.minitouch import PROTOCOL


def episode_seed(suite: str, task: str, index: int, run_seed: int) -> int:
    """Return the seed of one episode, 0 to 2^32 - 1.

    It does not depend on the number of episodes, the number of workers, or what ran before.
    """
    sequence = np.random.SeedSequence(
        [_number(PROTOCOL.name), _number(suite), _number(task), index, run_seed]
    )
    return int(sequence.generate_state(1, np.uint32)[0])


def policy_seed(episode: int) -> int:
    """Return the seed that a policy is given in the episode with this seed, 0 to 2^32 - 1.

    The world draws from the episode's own seed: a policy that draws from the same stream
    would be correlated with where things lie.
    """
    sequence = np.random.SeedSequence([_number("policy"), episode])
    return int(sequence.generate_state(1, np.uint32)[0])


def senses_generator(episode: int) -> np.random.Generator:
    """Return the generator of the noise on what is sensed in the episode with this seed.

    Like a policy, it shares no stream with the world.
    """
    return np.random.default_rng([_number("senses"), episode])


def suite_generator(suite: str) -> np.random.Generator:
    """Return the generator of what a suite draws once for all its runs."""
    return np.random.default_rng([_number(PROTOCOL.name), _number(suite)])


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
