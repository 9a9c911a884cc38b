"""Episodes of a run filmed again: their viewers and videos, on every core."""

import contextlib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import partial
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from minitouch_bench.episode import EpisodeSpec, Film, Observation, PlayedEpisode, Role
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.evaluation.policy_setup import Recording
from minitouch_bench.evaluation.rollout import run_episode
from minitouch_bench.files import REPLAYS, VIDEOS, make_folder, os_errors_as, view_name, write_file
from minitouch_bench.machine import require
from minitouch_bench.policies.policy import IMAGE_SHAPE, Policy
from minitouch_bench.processes import core_count, run_in_workers
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.reporting.viewer import ReplayedEpisode, episode_page
from minitouch_bench.runs.run import Run
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.text import numbered, printable
from minitouch_bench.verification.replay_check import is_as_recorded
from minitouch_bench.verification.static_check import refuse_unplayable

FRAMES_PER_SECOND = 8
"""A control step lasts about a quarter of a second: videos run at twice real time."""

PICTURE_SIZE = (240, 240)
"""Pixels of a picture for people, width and height."""


class _FilmedPolicy:
    """A policy with a camera: before each action it keeps the scene, and what it was given."""

    def __init__(self, policy: Policy, world: MiniTouchEnv) -> None:
        self._policy, self._world = policy, world
        self.scenes: list[NDArray[np.uint8]] = []
        self.images: list[NDArray[np.uint8]] = []
        self.touch: list[NDArray[np.float32]] = []

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode."""
        self._policy.reset(seed, task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the policy's action."""
        self.scenes.append(self._world.picture())
        self.images.append(observation["image"][0])
        self.touch.append(observation["touch"])
        return self._policy.act(observation)


def film_episode(
    recording: Recording, spec: EpisodeSpec, size: tuple[int, int] = PICTURE_SIZE
) -> Film:
    """Replay one episode in front of a camera; ``size``: width and height in pixels."""
    width, height = size
    plan = recording.plan
    world = MiniTouchEnv(
        spec.task,
        plan.load_objects(),
        perturbation=plan.conditions_in_light(),
        width=width,
        height=height,
    )
    with contextlib.closing(world):
        filmed = _FilmedPolicy(recording.make_policy(spec.role, lambda _: world), world)
        played = run_episode(world, filmed, spec)
        steps = len(played.trace.actions)
        scenes = [*filmed.scenes[:steps], world.picture()]
        images = np.array(filmed.images, np.uint8).reshape(-1, *IMAGE_SHAPE[1:])
        touch = np.array(filmed.touch, np.float32).reshape(-1, PROTOCOL.observation.touch_size)
        return Film(played, np.array(scenes), images, touch)


def write_video(film: Film, path: Path) -> None:
    """Write a film as an ``.mp4`` or a ``.gif``.

    Raises:
        MissingExtraError: an ``.mp4`` needs the extra ``video``.
        RunDirectoryError: the file cannot be written.
    """
    with os_errors_as(RunDirectoryError, path, "written"), TemporaryDirectory() as folder:
        file = Path(folder) / path.name
        if path.suffix == ".mp4":
            library = require_video()
            library.mimwrite(file, film.scenes, fps=FRAMES_PER_SECOND, macro_block_size=16)
        else:
            first, *rest = map(Image.fromarray, film.scenes)
            duration_ms = 1000 // FRAMES_PER_SECOND
            first.save(file, save_all=True, append_images=rest, duration=duration_ms, loop=0)
        write_file(path, file.read_bytes())


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


def replay_episode(run: Run, key: str) -> ReplayedEpisode:
    """Film an episode of a run, called as ``pushing/17``.

    Raises:
        UsageError: the run has no such episode, or cannot be replayed here.
        RunDirectoryError: a file of it is missing or damaged.
    """
    refuse_unplayable(run)
    spec, _ = run.find(key)
    film = film_episode(Recording.of(run, [spec]), spec)
    return ReplayedEpisode(run, film, is_as_recorded(run, film.played))


def refuse_other_scene(key: str, first: Run, second: Run) -> None:
    """Raise a ``UsageError`` unless both runs hold the same episode, played by the same rules."""
    (one, _), (other, _) = first.find(key), second.find(key)
    is_same = (one.seed, one.shape) == (other.seed, other.shape)
    if not is_same or one.task in first.header.rules_differ(second.header):
        raise UsageError(
            f"{key} is not the same episode in '{printable(first.place)}' and "
            f"'{printable(second.place)}': their seeds, shapes or rules differ"
        )


def film_to_files(run: Run, job: tuple[EpisodeSpec, Iterable[Path]]) -> PlayedEpisode:
    """Replay an episode once, and write a viewer or a video into each of the files.

    Raises:
        MissingExtraError: an ``.mp4`` needs the extra ``video``.
        RunDirectoryError: a file of the run is missing or damaged, or one cannot be written.
    """
    spec, paths = job
    film = film_episode(Recording.of(run, [spec]), spec)
    for path in paths:
        if path.suffix == ".html":
            episode_page(ReplayedEpisode(run, film, is_as_recorded(run, film.played))).save(path)
        else:
            write_video(film, path)
    return film.played


def film_run(
    run: Run,
    directory: Path,
    *,
    videos: int = 0,
    replays: int = 0,
    workers: int,
    callbacks: Callbacks,
) -> dict[str, Path]:
    """Film episodes of each task: the first ones as ``videos``, and ``replays``, failures first.

    Returns the replays by episode.

    Raises:
        RunDirectoryError: a file cannot be written.
        InfrastructureError: an episode cannot be replayed.
    """
    jobs: dict[EpisodeSpec, list[Path]] = defaultdict(list)
    for folder, suffix, specs in (
        (VIDEOS, ".mp4", _first(run, videos)),
        (REPLAYS, ".html", _failures_first(run, replays)),
    ):
        for spec in specs:
            jobs[spec].append(make_folder(directory / folder) / view_name(spec.key, suffix))
    if not jobs:
        return {}
    workers = min(workers, core_count())
    callbacks.note(f"filming {numbered(len(jobs), 'episode')}")
    callbacks.phase("filming", len(jobs))
    longest_first = sorted(jobs.items(), key=lambda job: -len(run.actions_of(job[0].key)))
    for _, played in run_in_workers(
        partial(film_to_files, run), longest_first, workers, name=lambda job: f"film {job[0].key}"
    ):
        callbacks.episode(played)
    return {
        spec.key: path for spec, paths in jobs.items() for path in paths if path.suffix == ".html"
    }


def _first(run: Run, count: int) -> Iterator[EpisodeSpec]:
    for _, specs in groupby(run.header.specs(), lambda spec: (spec.role, spec.task)):
        yield from list(specs)[:count]


def _failures_first(run: Run, count: int) -> Iterator[EpisodeSpec]:
    for task in run.tasks:
        pairs = [pair for pair in run.specs_and_rows() if pair[0].task == task]
        final = [pair for pair in pairs if pair[0].role is Role.FINAL]
        yield from (spec for spec, _ in sorted(final, key=lambda pair: pair[1].success)[:count])
