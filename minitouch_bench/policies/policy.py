"""What a policy is: what it sees, and what it gives."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.protocol.minitouch import PROTOCOL

Observation = Mapping[str, NDArray[Any]]
"""``image`` uint8 ``IMAGE_SHAPE`` and ``touch`` float32 ``TOUCH_SHAPE``."""

IMAGE_SHAPE, TOUCH_SHAPE = PROTOCOL.observation.image_shape, PROTOCOL.observation.touch_shape


class Policy(Protocol):
    """Anything that can be evaluated.

    Where its loader found something that its author should know, it has a text ``warning``.
    """

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode of a task; the seed is the episode's only source of chance."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the action, float32 (4,) or (5,), each number in [-1, 1]: see ``fit_action``."""


def close_policy(policy: Policy | None) -> None:
    """Tell a policy of the end of its episode, if it has a method ``close``: a server wants it."""
    if callable(close := getattr(policy, "close", None)):
        close()


def warning_of(policy: Policy) -> str:
    """Return what a policy's loader warns of, "" for nothing."""
    warning = getattr(policy, "warning", "")
    return warning if isinstance(warning, str) else ""


@dataclass(frozen=True)
class Checkpoint:
    """What a loader builds a policy from.

    ``content`` holds the file's bytes, read once and checked against its digest; ``target``
    names the file, the factory or the server.
    """

    target: str
    content: bytes = b""
    deterministic: bool = True


def action_size(task: str) -> int:
    """Return how many numbers an action of the task has."""
    return PROTOCOL.task(task).action_size


def zero_observation() -> dict[str, NDArray[Any]]:
    """Return a black image and an all-zero touch vector."""
    return {
        "image": np.zeros(IMAGE_SHAPE, np.uint8),
        "touch": np.zeros(TOUCH_SHAPE, np.float32),
    }
