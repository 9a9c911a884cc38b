"""A small dataset in Minari's format."""

from pathlib import Path

import gymnasium
import minari
import numpy as np
from minari.data_collector.episode_buffer import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage

LENGTHS = (4, 7)


def write_log(path: Path, touch_size=11, dense=False):
    spaces = gymnasium.spaces
    observation = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (1, 84, 84), np.uint8),
            "touch": spaces.Box(-50, 50, (touch_size,), np.float32),
        }
    )
    action = spaces.Box(-1, 1, (4,), np.float32)
    storage = MinariStorage.new(path, observation, action, jpeg_encoding=False)
    rng = np.random.default_rng(0)
    for length in LENGTHS:
        episode = EpisodeBuffer(
            observations={
                "image": rng.integers(0, 256, (length + 1, 1, 84, 84), dtype=np.uint8),
                "touch": rng.normal(size=(length + 1, touch_size)).astype(np.float32),
            },
            actions=rng.uniform(-1, 1, (length, 4)).astype(np.float32),
            rewards=[float(dense)] * (length - 1) + [25.0],
            terminations=[False] * (length - 1) + [True],
            truncations=[False] * length,
            infos={"is_success": np.arange(length + 1) == length} if dense else None,
        )
        storage.update_episodes([episode])
    storage.update_metadata({"dataset_id": "robot-v0", "minari_version": minari.__version__})
