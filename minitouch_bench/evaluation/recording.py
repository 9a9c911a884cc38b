"""What others can use of episodes: videos of a run, and a dataset in Minari's format."""

import contextlib
import re
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from minitouch_bench.episode import EpisodeSpec, Outcome, PlayedEpisode
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.files import VIDEOS, make_folder, os_errors_as, write_file
from minitouch_bench.machine import require
from minitouch_bench.processes import core_count, run_in_workers
from minitouch_bench.runs.plan import Plan
from minitouch_bench.runs.run import Run
from minitouch_bench.tasks.environment import OBJECT, MiniTouchEnv

FRAMES_PER_SECOND = 8
"""A control step lasts about a quarter of a second: videos run at twice real time."""

VIDEO_SIZE = (480, 480)
"""Pixels, width and height."""

Frames = Iterator[NDArray[np.uint8]]


def write_video(
    spec: EpisodeSpec,
    actions: NDArray[np.float32],
    path: Path,
    plan: Plan,
) -> Path:
    """Replay one episode of a plan in front of the camera into an ``.mp4`` or a ``.gif``.

    Raises:
        MissingExtraError: an ``.mp4`` needs the extra ``video``.
        UsageError: another kind of file.
        RunDirectoryError: the file cannot be written.
    """
    writers = {".mp4": _write_mp4, ".gif": _write_gif}
    if path.suffix not in writers:
        raise UsageError(f"a video is an .mp4 or a .gif, not '{path.name}'")
    with os_errors_as(RunDirectoryError, path, "written"), TemporaryDirectory() as folder:
        unfinished = Path(folder) / f"video{path.suffix}"
        writers[path.suffix](replay_frames(spec, actions, plan), unfinished)
        write_file(path, unfinished.read_bytes())
    return path


def film_run(run: Run, directory: Path, count: int) -> None:
    """Film the first ``count`` episodes of each task into the run's directory, on every core.

    Raises:
        RunDirectoryError: a video cannot be written.
        InfrastructureError: an episode cannot be replayed.
    """
    films = [
        (spec, run.actions_of(spec.key), make_folder(directory / VIDEOS) / video_name(spec.key))
        for spec in run.header.specs()
        if spec.index < count
    ]
    film = partial(_film, run.plan)
    for _ in run_in_workers(
        film, films, core_count(), name=lambda one: f"the film of {one[0].key}"
    ):
        pass


def _film(plan: Plan, film: tuple[EpisodeSpec, NDArray[np.float32], Path]) -> None:
    write_video(*film, plan)


def video_name(key: str, suffix: str = ".mp4") -> str:
    """Return the file name of an episode's video, as ``pushing-17.mp4``."""
    return key.replace("/", "-") + suffix


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


def _write_mp4(frames: Frames, path: Path) -> None:
    writer = require_video()
    with writer.get_writer(path, fps=FRAMES_PER_SECOND, macro_block_size=16) as video:
        for frame in frames:
            video.append_data(frame)


def _write_gif(frames: Frames, path: Path) -> None:
    pictures = [Image.fromarray(frame) for frame in frames]
    milliseconds = 1000 // FRAMES_PER_SECOND
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=milliseconds, loop=0)


def replay_frames(
    spec: EpisodeSpec,
    actions: NDArray[np.float32],
    plan: Plan,
    size: tuple[int, int] = VIDEO_SIZE,
) -> Frames:
    """Replay one episode of a plan and yield an image of its start and of each control step.

    ``size``: width and height in pixels.
    """
    width, height = size
    environment = MiniTouchEnv(
        spec.task,
        plan.load_objects(),
        "rgb_array",
        width=width,
        height=height,
        perturbation=plan.conditions,
    )
    try:
        environment.reset(seed=spec.seed, options={OBJECT: spec.shape})
        yield environment.picture()
        for action in actions:
            environment.step(action)
            yield environment.picture()
    finally:
        environment.close()


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
