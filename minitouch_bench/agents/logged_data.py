"""Episodes that somebody recorded: a robot, a policy, a person (Minari's dataset format)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from minitouch_bench.agents.replay import Replay
from minitouch_bench.errors import UsageError
from minitouch_bench.optional import require
from minitouch_bench.policies.policy import IMAGE_SHAPE, TOUCH_SHAPE
from minitouch_bench.simulation.observation import Observation


def fill_from_log(replay: Replay, path: Path, action_size: int) -> None:
    """Fill the replay memory with the episodes of a dataset directory.

    Observations are ``image`` uint8 (T + 1, 1, H, W) and ``touch`` float32 (T + 1, 11),
    actions float32 (T, A), as ``minitouch-bench record`` writes them.

    Raises:
        MissingExtraError: Minari is not installed.
        UsageError: there is no such dataset, or it is of another environment.
    """
    minari = require("minari", "data")
    try:
        dataset = minari.MinariDataset(path)
        episodes = list(dataset.iterate_episodes())
    except (OSError, ValueError, KeyError, AssertionError) as error:
        raise UsageError(f"{path} is no Minari dataset: {error}") from error
    for episode in episodes:
        _check(path, episode.observations, episode.actions.shape, action_size)
        images, touch = episode.observations["image"], episode.observations["touch"]
        successes = _successes(episode)
        replay.begin_episode(images[0], touch[0])
        for step, action in enumerate(episode.actions):
            replay.add(
                action,
                float(episode.rewards[step]),
                images[step + 1],
                touch[step + 1],
                success=bool(successes[step]),
                ended=bool(episode.terminations[step]),
            )
    if replay.rows <= len(episodes):
        raise UsageError(f"{path} holds no control step")


def _successes(episode: Any) -> Any:
    """Return whether each step reached the goal, (T,): what ``is_success`` in the infos says.

    Without it a step did that has a positive reward. Rewards of another kind need ``is_success``.
    """
    told = (episode.infos or {}).get("is_success")
    return episode.rewards > 0 if told is None else told[-len(episode.actions) :]  # no reset's


def _check(
    path: Path, observations: Observation, actions: tuple[int, ...], action_size: int
) -> None:
    """Refuse what is no episode of this task.

    Raises:
        UsageError: an array is missing, or has another form.
    """
    steps = actions[0]
    wanted = {"image": (steps + 1, *IMAGE_SHAPE), "touch": (steps + 1, *TOUCH_SHAPE)}
    arrays = observations if isinstance(observations, Mapping) else {}
    found = {name: np.shape(arrays.get(name, ())) for name in wanted}
    if found != wanted or actions[1:] != (action_size,):
        raise UsageError(
            f"{path} holds an episode with {found} and actions {actions}; wanted are {wanted} "
            f"and {action_size} numbers per action"
        )
