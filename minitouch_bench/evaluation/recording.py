"""What others can use of episodes: videos of a run, and a dataset in Minari's format."""

import contextlib
import re
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from minitouch_bench.episode import EpisodeSpec, Film, Outcome, PlayedEpisode
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.evaluation.policy_setup import PolicySetup, Recording
from minitouch_bench.evaluation.rollout import EpisodeRunner, run_episode
from minitouch_bench.files import os_errors_as, write_file
from minitouch_bench.machine import require
from minitouch_bench.policies.policy import IMAGE_SHAPE, Observation, Policy
from minitouch_bench.tasks.environment import OBJECT, MiniTouchEnv

FRAMES_PER_SECOND = 8
"""A control step lasts about a quarter of a second: videos run at twice real time."""

PICTURE_SIZE = (240, 240)
"""Pixels of a picture for people, width and height."""

Scenes = NDArray[np.uint8]


class _FilmedPolicy:
    """A policy with a camera: before each action it keeps the scene, and the image it was given."""

    def __init__(self, policy: Policy, world: MiniTouchEnv) -> None:
        self._policy, self._world = policy, world
        self.scenes: list[NDArray[np.uint8]] = []
        self.images: list[NDArray[np.uint8]] = []

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode."""
        self._policy.reset(seed, task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the policy's action."""
        self.scenes.append(self._world.picture())
        action = self._policy.act(observation)
        self.images.append(observation["image"][0])
        return action


def film_episode(
    recording: Recording, spec: EpisodeSpec, size: tuple[int, int] = PICTURE_SIZE
) -> Film:
    """Replay one episode in front of a camera; ``size``: width and height in pixels."""
    width, height = size
    plan = recording.plan
    world = MiniTouchEnv(
        spec.task,
        plan.load_objects(),
        perturbation=plan.conditions,
        width=width,
        height=height,
    )
    with contextlib.closing(world):
        filmed = _FilmedPolicy(recording.make_policy(spec.role, lambda _: world), world)
        played = run_episode(world, filmed, spec)
        steps = len(played.trace.actions)
        scenes = [*filmed.scenes[:steps], world.picture()]
        images = np.array(filmed.images, np.uint8).reshape(steps, *IMAGE_SHAPE[1:])
        target = getattr(world.task, "target", None)
        return Film(played, np.array(scenes), images, target)


def write_video(film: Film, path: Path) -> None:
    """Write a film as an ``.mp4`` or a ``.gif``.

    Raises:
        MissingExtraError: an ``.mp4`` needs the extra ``video``.
        RunDirectoryError: the file cannot be written.
    """
    write = _write_mp4 if path.suffix == ".mp4" else _write_gif
    with os_errors_as(RunDirectoryError, path, "written"), TemporaryDirectory() as folder:
        unfinished = Path(folder) / path.name
        write(film.scenes, unfinished)
        write_file(path, unfinished.read_bytes())


def video_suffix() -> str:
    """Return the kind of video that this installation can write."""
    return ".mp4" if find_spec("imageio_ffmpeg") and find_spec("imageio") else ".gif"


def require_video() -> Any:
    """Return imageio, which writes an ``.mp4``.

    Raises:
        MissingExtraError: it or its encoder is not installed.
    """
    require("imageio_ffmpeg", "video")
    return require("imageio.v2", "video")


def _write_mp4(scenes: Scenes, path: Path) -> None:
    with require_video().get_writer(path, fps=FRAMES_PER_SECOND, macro_block_size=16) as video:
        for scene in scenes:
            video.append_data(scene)


def _write_gif(scenes: Scenes, path: Path) -> None:
    first, *rest = map(Image.fromarray, scenes)
    milliseconds = 1000 // FRAMES_PER_SECOND
    first.save(path, save_all=True, append_images=rest, duration=milliseconds, loop=0)


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
