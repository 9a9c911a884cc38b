"""A policy in the evaluation's own process, without deadlines or limits: for debugging."""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import MiniTouchError, PolicyRaisedError
from minitouch_bench.policies.episode_child import seed_everything
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.policies.loading import FORMATS, check_permitted, load_policy
from minitouch_bench.policies.policy import (
    Checkpoint,
    Observation,
    Policy,
    action_size,
)
from minitouch_bench.policies.sources import PolicySource, read_checkpoint
from minitouch_bench.policies.wire import describe
from minitouch_bench.tasks.action import fit_action


class InProcessPolicy:
    """Load a policy afresh for every episode, beside the simulator.

    Only for what is trusted: it can read the simulator, keep what it likes between episodes,
    hang, or end the process.
    """

    def __init__(
        self, source: PolicySource, *, deterministic: bool = True, trust: bool = False
    ) -> None:
        self._source = source
        self._deterministic = deterministic
        self._trust = trust
        self._policy: Policy | None = None
        self._size = 0

    def reset(self, seed: int, task: str) -> None:
        """Load the policy and begin an episode.

        Raises:
            PolicyLoadError: the checkpoint cannot be loaded, or is not trusted.
            MissingExtraError: an optional package is not installed.
            PolicyRaisedError: the policy's own ``reset`` raised.

        """
        part = self._source.for_task(task)
        check_permitted(part.kind, part.target, Isolation.NONE, trust=self._trust)
        content = part.content
        if FORMATS[part.kind].suffixes:
            content = read_checkpoint(Path(part.target))
        checkpoint = Checkpoint(part.target, content, self._deterministic, self._trust)
        self._size = action_size(task)
        seed_everything(seed)
        self._policy = load_policy(part.kind, checkpoint)
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(1)
        seed_everything(seed)
        try:
            self._policy.reset(seed, task)
        except Exception as error:
            raise PolicyRaisedError(describe(error)) from error

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the policy's action, float32 of the task's size, finite, not clipped.

        Raises:
            InvalidActionError: wrong length or type, NaN or infinity.
            PolicyRaisedError: the policy's code raised.

        """
        if self._policy is None:
            raise RuntimeError("no episode has begun")
        own = {name: value.copy() for name, value in observation.items()}
        try:
            raw = self._policy.act(own)
        except MiniTouchError:
            raise
        except Exception as error:
            raise PolicyRaisedError(describe(error)) from error
        return fit_action(raw, self._size)

    def close(self) -> None:
        """Forget the policy, telling it so if it wants to know."""
        close = getattr(self._policy, "close", None)
        if callable(close):
            close()
        self._policy = None
