"""Recorded actions in place of a policy: an episode again, without the checkpoint."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.conditions import STANDARD, Conditions
from minitouch_bench.errors import PolicyFaultError
from minitouch_bench.policies.policy import Observation
from minitouch_bench.records import EpisodeSpec, Role
from minitouch_bench.tasks.environment import MiniTouchEnv

END_OF_RECORDING = "the recorded actions end before the episode does"
"""The fault of a replayed episode that its policy broke off."""


@dataclass(frozen=True)
class Recording:
    """The actions of a run by the keys of its episodes, float32 (T, A) each, as applied."""

    actions: Mapping[str, NDArray[np.float32]]
    conditions: Conditions = STANDARD

    def make_actor(self, role: Role) -> "RecordedActor":
        """Return an actor that repeats them."""
        return RecordedActor(self.actions)


class RecordedActor:
    """Repeats the actions of each episode, and fails where they end too early."""

    _rest: Iterator[NDArray[np.float32]]

    def __init__(self, actions: Mapping[str, NDArray[np.float32]]) -> None:
        self._actions = actions

    def reset(self, environment: MiniTouchEnv, spec: EpisodeSpec) -> None:
        """Find the episode's actions."""
        self._rest = iter(self._actions[spec.key])

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the next action.

        Raises:
            PolicyFaultError: there is none.
        """
        try:
            return next(self._rest)
        except StopIteration:
            raise PolicyFaultError(END_OF_RECORDING) from None

    def close(self) -> None:
        """Do nothing: there is nothing to free."""
