"""MiniTouch in LeRobot's form: ``make_env`` returns the four tasks as vector environments.

LeRobot's EnvHub downloads this file and calls ``make_env``. It needs minitouch-bench only.
"""

from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv

from minitouch_bench.policies.lerobot import INSTRUCTIONS, as_lerobot_image
from minitouch_bench.protocol.minitouch import PROTOCOL, TASK_NAMES

SUITE = "minitouch"

VIDEO_SIZE = 240
"""Width and height of what ``render`` returns, in pixels: it takes 10 times as long as a step."""


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None
) -> dict[str, dict[int, VectorEnv]]:
    """Return ``{"minitouch": {task_id: vector environment}}``.

    ``cfg.task`` selects tasks by name, separated by commas; without it, all four. A finished
    episode is reset in the same step, and ``info["final_info"]`` has its last ``info``.

    Raises:
        ValueError: ``n_envs`` is below 1, or there is no such task.
    """
    if n_envs < 1:
        raise ValueError(f"n_envs is {n_envs}; it must be at least 1")
    chosen = choose_tasks(getattr(cfg, "task", None))
    size = action_size(chosen)
    return {
        SUITE: {
            task_id: _vector([partial(_make_one, name, size)] * n_envs, use_async_envs)
            for task_id, name in enumerate(TASK_NAMES)
            if name in chosen
        }
    }


def choose_tasks(names: str | None) -> list[str]:
    """Return the tasks that ``names`` lists, separated by commas; all of them for None.

    Raises:
        ValueError: there is no such task.
    """
    chosen = [name.strip() for name in names.split(",")] if names else [*TASK_NAMES]
    if unknown := [name for name in chosen if name not in TASK_NAMES]:
        raise ValueError(f"no task '{unknown[0]}'; the tasks are {', '.join(TASK_NAMES)}")
    return chosen


def action_size(tasks: list[str]) -> int:
    """Return the length of an action that fits all these tasks; a task of 4 ignores the fifth."""
    return max(PROTOCOL.task(name).action_size for name in tasks)


def _vector(makers: list[partial[gymnasium.Env[Any, Any]]], use_async: bool) -> VectorEnv:
    if use_async and len(makers) > 1:
        # A forked copy of a process with threads, such as torch's, can deadlock.
        return AsyncVectorEnv(makers, context="forkserver", autoreset_mode=AutoresetMode.SAME_STEP)
    return SyncVectorEnv(makers, autoreset_mode=AutoresetMode.SAME_STEP)


def _make_one(name: str, size: int) -> gymnasium.Env[Any, Any]:
    environment = gymnasium.make(
        f"minitouch_bench:{PROTOCOL.task(name).gym_id}",
        render_mode="rgb_array",
        width=VIDEO_SIZE,
        height=VIDEO_SIZE,
    )
    return LeRobotForm(environment, name, size)


class LeRobotForm(gymnasium.ObservationWrapper):
    """A task with the observations, the options and the names that LeRobot reads.

    ``pixels`` is the gray image as uint8 (84, 84, 3), ``agent_pos`` the touch vector, float32
    (11,): position of the end effector, finger openings, finger forces. ``task`` and
    ``task_description`` are the task's name and its instruction.
    """

    def __init__(self, environment: gymnasium.Env[Any, Any], name: str, size: int) -> None:
        super().__init__(environment)
        self.task = name
        self.task_description = INSTRUCTIONS[name]
        seen = environment.observation_space
        _, height, width = seen["image"].shape
        self.observation_space = spaces.Dict(
            pixels=spaces.Box(0, 255, (height, width, 3), np.uint8), agent_pos=seen["touch"]
        )
        self.action_space = spaces.Box(-1.0, 1.0, (size,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode. LeRobot's own options, such as ``lerobot_new_rollout``, are ignored."""
        given = options or {}
        own = {key: value for key, value in given.items() if not key.startswith("lerobot_")}
        return super().reset(seed=seed, options=own)

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Return what the task shows, in LeRobot's form."""
        return {
            "pixels": as_lerobot_image(observation["image"]),
            "agent_pos": observation["touch"],
        }
