"""Run the recipes of docs/how-to/export-a-policy.md: page and tests cannot differ."""

import contextlib
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from minitouch_bench.simulation.observation import observation_space

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "export-a-policy.md"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


class StillEnvironment(gym.Env[dict[str, Any], np.ndarray]):
    """An environment with the benchmark's spaces in which nothing moves."""

    def __init__(self, action_size: int = 5, image_shape: tuple[int, ...] = (1, 84, 84)) -> None:
        self.observation_space = observation_space(50.0)
        self.observation_space["image"] = spaces.Box(0, 255, image_shape, np.uint8)
        self.action_space = spaces.Box(-1.0, 1.0, (action_size,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return self.observation_space.sample(), {}

    def step(self, action: np.ndarray) -> Any:
        return self.observation_space.sample(), 0.0, False, False, {}


def run_recipes(directory: Path, *mentions: str) -> dict[str, Any]:
    """Run, in a directory, the blocks that define the network and those with a mention."""
    names: dict[str, Any] = {"environment": StillEnvironment()}
    wanted = ("TouchActor(", *mentions)
    with contextlib.chdir(directory):
        for block in BLOCK.findall(PAGE.read_text()):
            if any(mention in block for mention in wanted):
                exec(compile(block, str(PAGE), "exec"), names)
    return names
