"""A policy's episodes as a dataset in Minari's format."""

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from minitouch_bench.episode import EpisodeSpec, Outcome, PlayedEpisode
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.files import os_errors_as
from minitouch_bench.machine import require
from minitouch_bench.tasks.environment import OBJECT, MiniTouchEnv


def record_episodes(
    setup: PolicySetup, specs: list[EpisodeSpec], directory: Path, callbacks: Callbacks
) -> int:
    """Record a policy's episodes of one task; the directory appears when the dataset is complete.

    Returns how many episodes end with a fault of the policy; such an episode is truncated.

    Raises:
        MissingExtraError: Minari is not installed.
        RunDirectoryError: the directory is there already, or cannot be written.
    """
    minari = require("minari", "data")
    storages = require("minari.dataset.minari_storage", "data")
    task = specs[0].task
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", setup.policy.name).strip("-") or "policy"
    faults = 0
    with (
        _new_directory(directory) as folder,
        contextlib.closing(MiniTouchEnv(task)) as environment,
        contextlib.closing(EpisodeRunner(setup)) as runner,
    ):
        storage = storages.MinariStorage.new(
            folder,
            environment.observation_space,
            environment.action_space,
            jpeg_encoding=False,  # pictures as they are
        )
        callbacks.phase("recording", len(specs))
        for spec in specs:
            played = runner.run(spec)
            if len(played.trace.actions):  # none where the policy failed at the reset
                storage.update_episodes([_episode(environment, played)])
            callbacks.episode(played)
            faults += played.outcome is Outcome.POLICY_FAULT
        storage.update_metadata(
            {
                "dataset_id": f"minitouch/{task}/{name}-v0",
                "minari_version": minari.__version__,
                "algorithm_name": setup.policy.name,
            }
        )
    return faults


@contextlib.contextmanager
def _new_directory(directory: Path) -> Iterator[Path]:
    """Give a path beside a new directory; what is written there becomes it when the block ends."""
    if directory.exists():
        raise RunDirectoryError(f"{directory} is there already; choose another --output")
    with os_errors_as(RunDirectoryError, directory, "written"):
        directory.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{directory.name}-", dir=directory.parent) as folder:
            # Minari joins a relative path to itself.
            unfinished = Path(folder).absolute() / directory.name
            yield unfinished
            unfinished.rename(directory)


def _episode(environment: MiniTouchEnv, played: PlayedEpisode) -> Any:
    """Return an episode with its pictures: its actions done again give the same bits."""
    buffers = require("minari.data_collector.episode_buffer", "data")
    spec, trace = played.spec, played.trace
    images = [environment.reset(seed=spec.seed, options={OBJECT: spec.shape})[0]["image"]]
    images += [environment.step(action)[0]["image"] for action in trace.actions]
    last = np.arange(len(trace.actions)) == len(trace.actions) - 1
    terminated = last & (played.outcome in (Outcome.SUCCESS, Outcome.LEFT_WORKSPACE))
    success = last & (played.outcome is Outcome.SUCCESS)
    return buffers.EpisodeBuffer(
        seed=spec.seed,
        observations={"image": np.stack(images), "touch": trace.touch},
        actions=trace.actions,
        rewards=trace.rewards.tolist(),
        terminations=terminated.tolist(),
        truncations=(last & ~terminated).tolist(),
        infos={"is_success": np.concatenate(([False], success))},
    )
