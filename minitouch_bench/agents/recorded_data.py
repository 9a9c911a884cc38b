"""Episodes that somebody recorded: a robot, a policy, a person (Minari's dataset format)."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.agents.memory import ReplayMemory, damage_as
from minitouch_bench.errors import UsageError
from minitouch_bench.machine import require_minari
from minitouch_bench.policies.policy import IMAGE_SHAPE, TOUCH_SHAPE

LARGEST_VALUE = 1e4
"""The largest number that a touch sensor in m and N, or a reward, may have."""


def fill_from_dataset(memory: ReplayMemory, path: Path, action_size: int) -> None:
    """Fill the replay memory with a dataset directory, as ``minitouch-bench record`` writes it.

    Raises:
        MissingExtraError: Minari is not installed.
        UsageError: there is no such dataset, it is of another environment, damaged or larger
            than the memory.
    """
    minari = require_minari()
    with damage_as(UsageError, f"{path} is not a Minari dataset of this task"):
        for episode in minari.MinariDataset(path).iterate_episodes():
            _add_episode(memory, episode, action_size)
    if not memory.rows:
        raise UsageError(f"{path} contains no control step")
    if memory.rows > memory.capacity:
        raise UsageError(
            f"{path} contains {memory.rows:,} observations, the memory {memory.capacity:,}: set a "
            "larger replay_size"
        )


def _add_episode(memory: ReplayMemory, episode: Any, action_size: int) -> None:
    """Add an episode of T control steps, whose arrays have the task's shapes.

    Raises:
        ValueError: an array has another shape or type, or a number that cannot be.
        LookupError, TypeError, AttributeError: an array is missing.
    """
    images, steps = episode.observations["image"], len(episode.actions)
    if not steps:
        raise ValueError("an episode has no control step")
    if images.dtype != np.uint8 or images.shape != (steps + 1, *IMAGE_SHAPE):
        raise ValueError(f"its images are {images.dtype} {images.shape}")
    touch = _numbers(episode.observations["touch"], "touch", (steps + 1, *TOUCH_SHAPE))
    actions = _numbers(episode.actions, "actions", (steps, action_size), 1.0)
    rewards = _numbers(episode.rewards, "rewards", (steps,))
    ended = _numbers(episode.terminations, "terminations", (steps,))
    # A reward of another kind needs ``is_success``; its first value may be the reset's.
    reached = (episode.infos or {}).get("is_success", rewards > 0)[-steps:]
    success = _numbers(reached, "is_success", (steps,))
    memory.begin_episode(images[0], touch[0].astype(np.float32))
    for step, action in enumerate(actions.astype(np.float32)):
        memory.add(
            action,
            float(rewards[step]),
            images[step + 1],
            touch[step + 1].astype(np.float32),
            success=bool(success[step]),
            ended=bool(ended[step]),
        )


def _numbers(
    array: NDArray[Any], name: str, shape: tuple[int, ...], largest: float = LARGEST_VALUE
) -> NDArray[np.float64]:
    if array.shape != shape:
        raise ValueError(f"its {name} are {array.shape}; wanted is {shape}")
    numbers = array.astype(np.float64)
    if not (np.abs(numbers) <= largest).all():  # NaN is not
        raise ValueError(f"its {name} are not numbers within ±{largest:g}")
    return numbers
