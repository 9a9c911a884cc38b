"""What a policy is: what it sees, what it gives, and when its action is refused."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import InvalidActionError
from minitouch_bench.protocol.minitouch import PROTOCOL

Observation = Mapping[str, NDArray[Any]]
"""``image`` uint8 (1, 84, 84) and ``touch`` float32 (11,)."""

IMAGE_SHAPE = (1, PROTOCOL.observation.image_size, PROTOCOL.observation.image_size)
TOUCH_SHAPE = (PROTOCOL.observation.touch_size,)

ACTION_SIZES = tuple(sorted({task.action_size for task in PROTOCOL.tasks}))
"""The lengths an action can have; Opening alone has the fifth number, the yaw."""

FLOAT_BYTES = (2, 4, 8)
"""Item sizes of the floating types that an action may come in."""


class Policy(Protocol):
    """Anything that can be evaluated."""

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode of a task; the seed is the episode's only source of chance."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the action, float32 (4,), in Opening (5,), each number in [-1, 1]."""


@dataclass(frozen=True)
class Checkpoint:
    """What a loader builds a policy from.

    ``content`` holds the file's bytes, read once and checked against its digest; ``target``
    names the file, the factory or the server. ``trust`` permits code of the submitter's own.
    """

    target: str
    content: bytes = b""
    deterministic: bool = True
    trust: bool = False


def action_size(task: str) -> int:
    """Return how many numbers an action of the task has."""
    return PROTOCOL.task(task).action_size


def zero_observation() -> dict[str, NDArray[Any]]:
    """Return a black image and an all-zero touch vector."""
    return {
        "image": np.zeros(IMAGE_SHAPE, np.uint8),
        "touch": np.zeros(TOUCH_SHAPE, np.float32),
    }


def validate_action(raw: object, size: int) -> NDArray[np.float32]:
    """Return an action as float32 (size,), unclipped.

    A leading batch axis of 1 is dropped. Where 4 numbers are needed, the first 4 of 5 are
    taken, so that one checkpoint can serve every task.

    Raises:
        InvalidActionError: it is no floating-point vector of that length, or not finite.

    """
    try:
        action = np.asarray(raw)
    except Exception as error:
        raise InvalidActionError("the action is not an array of numbers") from error
    if action.dtype.kind != "f" or action.dtype.itemsize not in FLOAT_BYTES:
        raise InvalidActionError(f"the action is of type {action.dtype}, not float32")
    if action.ndim == 2 and action.shape[0] == 1:
        action = action[0]
    if action.ndim != 1:
        raise InvalidActionError(f"the action has shape {action.shape}, not ({size},)")
    if len(action) != size and (size, len(action)) != ACTION_SIZES:
        raise InvalidActionError(f"the action has {len(action)} numbers, not {size}")
    with np.errstate(over="ignore"):  # a float64 too large becomes infinite, and is refused below
        action = np.array(action[:size], dtype=np.float32)
    if not np.isfinite(action).all():
        raise InvalidActionError("the action holds NaN or infinity")
    return action
