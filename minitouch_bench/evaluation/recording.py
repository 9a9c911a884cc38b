"""Episodes as a dataset: written in Minari's format or in LeRobot's, and read in Minari's."""

import contextlib
import logging
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench import errors, files
from minitouch_bench.episode import EpisodeSpec, Outcome, PlayedEpisode
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.machine import require, require_minari
from minitouch_bench.policies import lerobot
from minitouch_bench.policies.policy import IMAGE_SHAPE, TOUCH_SHAPE
from minitouch_bench.protocol.spec import TaskSpec
from minitouch_bench.tasks.environment import OBJECT, MiniTouchEnv

TOUCH_NAMES = (
    "x", "y", "z", "left_opening", "right_opening", "left_force_x", "left_force_y", "left_force_z",
    "right_force_x", "right_force_y", "right_force_z",
)  # fmt: skip
ACTION_NAMES = ("dx", "dy", "dz", "finger", "yaw")
"""Names of the numbers of touch and of an action in LeRobot's format."""


class MinariWriter:
    """Minari's format, HDF5; pictures as they are."""

    library = staticmethod(require_minari)

    def __init__(self, folder: Path, environment: MiniTouchEnv, policy: str) -> None:
        self._buffers = require("minari.data_collector.episode_buffer", "data")
        storages = require("minari.dataset.minari_storage", "data")
        spaces = environment.observation_space, environment.action_space
        self._storage = storages.MinariStorage.new(folder, *spaces, jpeg_encoding=False)
        self._policy, self._name = policy, _dataset_name(environment, policy)

    def add(self, episode: PlayedEpisode, images: NDArray[np.uint8]) -> None:
        """Write an episode; ``is_success`` begins with the reset's."""
        trace, outcome = episode.trace, episode.outcome
        last = np.arange(len(trace.actions)) == len(trace.actions) - 1
        terminated = last & (outcome in (Outcome.SUCCESS, Outcome.LEFT_WORKSPACE))
        success = last & (outcome is Outcome.SUCCESS)
        buffer = self._buffers.EpisodeBuffer(
            seed=episode.spec.seed,
            observations={"image": images, "touch": trace.touch},
            actions=trace.actions,
            rewards=trace.rewards.tolist(),
            terminations=terminated.tolist(),
            truncations=(last & ~terminated).tolist(),
            infos={"is_success": np.concatenate(([False], success))},
        )
        self._storage.update_episodes([buffer])

    def finish(self) -> None:
        """Write the dataset's id and version."""
        self._storage.update_metadata(
            {
                "dataset_id": f"{self._name}-v0",
                "minari_version": self.library().__version__,
                "algorithm_name": self._policy,
            }
        )


class LeRobotWriter:
    """LeRobot's format, version 3: Parquet with a PNG per control step, no video.

    It has an episode's observations before each action, so not the one that the last led to.
    """

    @staticmethod
    def library() -> Any:
        """Import LeRobot's datasets, which otherwise print a page and a bar per episode.

        Raises:
            MissingExtraError: LeRobot is not installed.
        """
        os.environ.setdefault("HF_DATASETS_DISABLE_PROGRESS_BARS", "1")
        logging.getLogger("lerobot").setLevel(logging.ERROR)
        return require("lerobot.datasets", "lerobot")

    def __init__(self, folder: Path, environment: MiniTouchEnv, policy: str) -> None:
        self._instruction = lerobot.INSTRUCTIONS[environment.task.spec.name]
        depth, height, width = lerobot.SEEN[lerobot.IMAGE]
        size = environment.task.spec.action_size
        features = {
            lerobot.IMAGE: ("image", (height, width, depth), ("height", "width", "channels")),
            lerobot.STATE: ("float32", (len(TOUCH_NAMES),), TOUCH_NAMES),
            "action": ("float32", (size,), ACTION_NAMES[:size]),
            "next.reward": ("float32", (1,), None),
            "next.done": ("bool", (1,), None),
            "next.success": ("bool", (1,), None),
        }
        self._dataset = self.library().LeRobotDataset.create(
            _dataset_name(environment, policy),
            environment.metadata["render_fps"],
            {
                name: {"dtype": dtype, "shape": shape, "names": names and list(names)}
                for name, (dtype, shape, names) in features.items()
            },
            root=folder,
            robot_type="panda",
            use_videos=False,
        )

    def add(self, episode: PlayedEpisode, images: NDArray[np.uint8]) -> None:
        """Write an episode, whose frames have the observation and the action upon it."""
        trace = episode.trace
        for step, action in enumerate(trace.actions):
            is_last = step == len(trace.actions) - 1
            self._dataset.add_frame(
                {
                    lerobot.IMAGE: lerobot.as_lerobot_image(images[step]),
                    lerobot.STATE: trace.touch[step],
                    "action": action,
                    "next.reward": trace.rewards[step : step + 1],
                    "next.done": np.array([is_last]),
                    "next.success": np.array([is_last and episode.outcome is Outcome.SUCCESS]),
                    "task": self._instruction,
                }
            )
        self._dataset.save_episode()

    def finish(self) -> None:
        """Write the ends of the files."""
        self._dataset.finalize()


Writer = type[MinariWriter] | type[LeRobotWriter]
DATASET_WRITERS: Mapping[str, Writer] = {"minari": MinariWriter, "lerobot": LeRobotWriter}
"""The writers of datasets by the name of their format."""


def record_episodes(
    setup: PolicySetup,
    specs: list[EpisodeSpec],
    directory: Path,
    callbacks: Callbacks,
    writer: Writer = MinariWriter,
) -> int:
    """Record a policy's episodes of one task; the directory appears when the dataset is complete.

    Returns how many episodes end with a fault of the policy; such an episode is truncated.

    Raises:
        MissingExtraError: the format's package is not installed.
        RunDirectoryError: the directory is there already, or cannot be written.
    """
    faults = 0
    with (
        _new_directory(directory) as folder,
        contextlib.closing(MiniTouchEnv(specs[0].task)) as environment,
        contextlib.closing(EpisodeRunner(setup)) as runner,
    ):
        dataset = writer(folder, environment, setup.policy.name)
        callbacks.phase("recording", len(specs))
        for spec in specs:
            played = runner.run(spec)
            if len(played.trace.actions):  # none where the policy failed at the reset
                dataset.add(played, _show(environment, played))
            callbacks.episode(played)
            faults += played.outcome is Outcome.POLICY_FAULT
        dataset.finish()
    return faults


def _dataset_name(environment: MiniTouchEnv, policy: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", policy).strip("-") or "policy"
    return f"minitouch/{environment.task.spec.name}/{name}"


@contextlib.contextmanager
def _new_directory(directory: Path) -> Iterator[Path]:
    """Give a path beside a new directory; what is written there becomes it when the block ends.

    What a killed process left there is removed.
    """
    if directory.exists():
        raise errors.RunDirectoryError(f"{directory} is there already; choose another --output")
    directory = directory.absolute()  # Minari joins a relative path to itself
    folder = directory.with_name(f".{directory.name}.unfinished")
    unfinished = folder / directory.name
    try:
        with (
            files.os_errors_as(errors.RunDirectoryError, directory, "written"),
            files.lock_directory(folder),
            contextlib.ExitStack() as stack,
        ):
            shutil.rmtree(unfinished, ignore_errors=True)
            stack.callback(shutil.rmtree, unfinished, ignore_errors=True)
            yield unfinished
            unfinished.rename(directory)
    finally:
        with contextlib.suppress(OSError):  # another process works there
            folder.rmdir()


def _show(environment: MiniTouchEnv, played: PlayedEpisode) -> NDArray[np.uint8]:
    """Return the images of an episode: its actions done again give the same bits."""
    spec = played.spec
    images = [environment.reset(seed=spec.seed, options={OBJECT: spec.shape})[0]["image"]]
    images += [environment.step(action)[0]["image"] for action in played.trace.actions]
    return np.stack(images)


# Reading

LARGEST_VALUE = 1e4
"""The largest number that a touch sensor in m and N, or a reward, may have."""


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode of T control steps, by a robot, a policy or a person.

    ``images`` uint8 (T + 1, 1, H, W), ``touch`` float32 (T + 1, 11), ``actions`` float32 (T, A);
    ``rewards``, ``ended`` (for good, not by a step limit) and ``success``: float32 (T,).
    """

    images: NDArray[np.uint8]
    touch: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]
    ended: NDArray[np.float32]
    success: NDArray[np.float32]


def read_episodes(path: Path, task: TaskSpec) -> Iterator[RecordedEpisode]:
    """Read the episodes of a Minari dataset, a directory as ``minitouch-bench record`` writes it.

    What ``record`` wrote names its task; any other dataset is of the task if its arrays fit.

    Raises:
        MissingExtraError: Minari is not installed.
        UsageError: there is no such dataset, it is damaged, or of another environment.
    """
    minari = require_minari()
    with files.damage_as(errors.UsageError, f"{path} is not a Minari dataset of this task"):
        dataset = minari.MinariDataset(path)
        namespace, *named = str(dataset.spec.dataset_id).split("/")
        if namespace == "minitouch" and named and named[0] != task.name:
            raise ValueError(f"it was recorded in {named[0]}, and this is {task.name}")
        for episode in dataset.iterate_episodes():
            yield _checked(episode, task.action_size)


def _checked(episode: Any, action_size: int) -> RecordedEpisode:
    """Return an episode whose arrays have the task's shapes.

    Raises:
        ValueError: an array has another shape or type, or a number that cannot be.
        LookupError, TypeError, AttributeError: an array is missing.
    """
    images, steps = episode.observations["image"], len(episode.actions)
    if not steps:
        raise ValueError("an episode has no control step")
    if images.dtype != np.uint8 or images.shape != (steps + 1, *IMAGE_SHAPE):
        raise ValueError(f"its images are {images.dtype} {images.shape}")
    rewards = _numbers("rewards", episode.rewards, (steps,))
    # A reward of another kind needs ``is_success``; its first value may be the reset's.
    reached = (episode.infos or {}).get("is_success", rewards > 0)[-steps:]
    return RecordedEpisode(
        images,
        _numbers("touch", episode.observations["touch"], (steps + 1, *TOUCH_SHAPE)),
        _numbers("actions", episode.actions, (steps, action_size), 1.0),
        rewards,
        _numbers("terminations", episode.terminations, (steps,)),
        _numbers("is_success", reached, (steps,)),
    )


def _numbers(
    name: str, array: NDArray[Any], shape: tuple[int, ...], largest: float = LARGEST_VALUE
) -> NDArray[np.float32]:
    if array.shape != shape:
        raise ValueError(f"its {name} are {array.shape}; wanted is {shape}")
    if not (np.abs(array) <= largest).all():  # NaN is not
        raise ValueError(f"its {name} are not numbers within ±{largest:g}")
    return array.astype(np.float32)
