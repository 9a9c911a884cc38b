"""Episodes of fixed actions, and the digest of everything seen in them."""

import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.tasks.environment import MiniTouchEnv


def random_actions(environment: Any, seed: int, steps: int) -> NDArray[np.float32]:
    """Return float32 (steps, A), a part of it outside [-1, 1]."""
    rng = np.random.default_rng(seed)
    size = environment.action_space.shape[-1]
    return rng.uniform(-1.2, 1.2, (steps, size)).astype(np.float32)


def play(environment: MiniTouchEnv, seed: int, steps: int) -> Iterator[str]:
    """Yield the digest of all seen so far, at the reset and after each step."""
    sha = hashlib.sha256()

    def see(*things: Any) -> str:
        for thing in things:
            values = list(thing.values()) if isinstance(thing, dict) else [thing]
            for value in values:
                sha.update(
                    value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()
                )
        return sha.hexdigest()

    yield see(*environment.reset(seed=seed))
    for action in random_actions(environment, seed, steps):
        observation, reward, terminated, truncated, info = environment.step(action)
        yield see(observation, reward, terminated, truncated, info)
        if terminated or truncated:
            return


def digest(environment: MiniTouchEnv, seed: int, steps: int) -> str:
    """Return the digest of a whole episode."""
    return list(play(environment, seed, steps))[-1]


def overlapping(client: PhysicsClient, one: int, other: int, distance: float) -> bool:
    """Tell whether two bodies are closer than ``distance`` (m) in their present poses."""
    return len(client._bullet.getClosestPoints(one, other, distance)) > 0
