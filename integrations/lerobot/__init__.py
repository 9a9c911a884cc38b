"""The environment type ``minitouch`` of lerobot-eval and lerobot-train.

LeRobot imports this package by itself, because of its distribution's name.
"""

from dataclasses import dataclass
from typing import Any

from lerobot_env_minitouch.env import action_size, choose_tasks, make_env

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_IMAGE, OBS_STATE


@EnvConfig.register_subclass("minitouch")
@dataclass
class MiniTouchConfig(EnvConfig):
    """``task``: names separated by commas; None for all four."""

    task: str | None = None
    fps: int = 4

    def __post_init__(self) -> None:
        size = action_size(choose_tasks(self.task))
        self.features = {
            ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(size,)),
            "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=(11,)),
            "pixels": PolicyFeature(type=FeatureType.VISUAL, shape=(84, 84, 3)),
        }
        self.features_map = {ACTION: ACTION, "agent_pos": OBS_STATE, "pixels": OBS_IMAGE}

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """None: ``create_envs`` makes the environments."""
        return {}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, Any]:
        """Return the vector environments of the tasks, as ``make_env`` does."""
        return make_env(n_envs, use_async_envs, self)
