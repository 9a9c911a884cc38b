"""The floors of every table: random actions, none at all, and a fixed sequence played blind.

The classes are their own loaders: there is nothing to load.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.policy import Checkpoint, Observation, action_size


class _Baseline:
    def __init__(self, checkpoint: Checkpoint) -> None:
        pass


class RandomPolicy(_Baseline):
    """Draw every number uniformly from [-1, 1), from the episode's seed."""

    def reset(self, seed: int, task: str) -> None:
        """Start the episode's own stream of numbers."""
        self._generator = np.random.default_rng(seed)
        self._size = action_size(task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return a uniformly random action."""
        return self._generator.uniform(-1.0, 1.0, self._size).astype(np.float32)


OPEN_LOOP_FILE = Path(__file__).with_name("open_loop.npz")
"""One action sequence per task, float32 (T, A); ``benchmarks.open_loop`` chooses them."""


class OpenLoopPolicy:
    """Play one fixed action sequence per task, then hold still; look at nothing."""

    def __init__(self, checkpoint: Checkpoint) -> None:
        with np.load(OPEN_LOOP_FILE) as file:
            self._sequences = {task: file[task] for task in file.files}

    def reset(self, seed: int, task: str) -> None:
        """Start the task's sequence; without one it holds still from the start."""
        nothing = np.zeros((0, action_size(task)), np.float32)
        self._actions, self._step = self._sequences.get(task, nothing), 0

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the next action of the sequence, zeros after its end."""
        self._step += 1
        if self._step > len(self._actions):
            return np.zeros(self._actions.shape[1], np.float32)
        action: NDArray[np.float32] = self._actions[self._step - 1]
        return action


class ZeroPolicy(_Baseline):
    """Never move."""

    def reset(self, seed: int, task: str) -> None:
        """Note the task's action size."""
        self._size = action_size(task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return an action of zeros."""
        return np.zeros(self._size, np.float32)
