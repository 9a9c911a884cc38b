"""Seeds of episodes: a function of what the episode is, and of nothing else."""

import hashlib
import json

import numpy as np

from minitouch_bench.protocol.minitouch import PROTOCOL

PUBLIC_SEED_BITS = 64
"""A run seed of more bits is a secret; its episodes' seeds are then too many to be tried."""


def episode_seed(suite: str, task: str, index: int, run_seed: int) -> int:
    """Return the seed of one episode: 0 to 2^32 - 1, and to 2^128 - 1 where the run's is secret.

    It does not depend on the number of episodes, the number of workers, or what ran before.
    """
    sequence = np.random.SeedSequence(
        [_number(PROTOCOL.name), _number(suite), _number(task), index, run_seed]
    )
    words = 1 if run_seed.bit_length() <= PUBLIC_SEED_BITS else 4
    return int.from_bytes(
        sequence.generate_state(words, np.uint32).astype("<u4").tobytes(), "little"
    )


def policy_seed(suite: str, task: str, index: int, run_seed: int) -> int:
    """Return the seed that a policy is given in one episode, 0 to 2^64 - 1.

    SHA-256 over what the episode's seed is made of, not over that seed: a policy that could
    compute the episode's seed from its own could build the scene and look at it.
    """
    text = json.dumps(["policy", PROTOCOL.name, suite, task, index, run_seed])
    return _number(text)


def senses_generator(episode: int) -> np.random.Generator:
    """Return the generator of noise on an episode's senses, apart from that of its scene."""
    return np.random.default_rng([_number("senses"), episode])


def suite_generator(suite: str) -> np.random.Generator:
    """Return the generator of what a suite draws once for all its runs."""
    return np.random.default_rng([_number(PROTOCOL.name), _number(suite)])


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
