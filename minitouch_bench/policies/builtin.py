"""The two floors of every table: uniformly random actions, and none at all."""

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.policy import Checkpoint, Observation, action_size


class RandomPolicy:
    """Draw every number uniformly from [-1, 1), from the episode's seed."""

    def reset(self, seed: int, task: str) -> None:
        """Start the episode's own stream of numbers."""
        self._generator = np.random.default_rng(seed)
        self._size = action_size(task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return a uniformly random action."""
        return self._generator.uniform(-1.0, 1.0, self._size).astype(np.float32)


class ZeroPolicy:
    """Never move."""

    def reset(self, seed: int, task: str) -> None:
        """Note the task's action size."""
        self._size = action_size(task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return an action of zeros."""
        return np.zeros(self._size, np.float32)


def load_random(checkpoint: Checkpoint) -> RandomPolicy:  # noqa: ARG001 - a loader's signature
    """Return the random policy."""
    return RandomPolicy()


def load_zero(checkpoint: Checkpoint) -> ZeroPolicy:  # noqa: ARG001 - a loader's signature
    """Return the policy that never moves."""
    return ZeroPolicy()
