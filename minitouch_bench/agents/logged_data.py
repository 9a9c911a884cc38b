"""Episodes that somebody recorded: a robot, a policy, a person (Minari's dataset format)."""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.agents.replay import Replay
from minitouch_bench.errors import UsageError
from minitouch_bench.files import MIB, open_plain, read_file
from minitouch_bench.optional import require
from minitouch_bench.policies.policy import IMAGE_SHAPE, TOUCH_SHAPE

METADATA_FILE, DATA_FILE = "metadata.json", "main_data.hdf5"

LONGEST_EPISODE = 20_000
"""The most control steps of a recorded episode: 135 MiB of images."""
LARGEST_CHUNK = 256 * MIB
"""The most bytes that are unpacked at once."""

LARGEST_VALUE = 1e4
"""The largest number that a touch sensor in m and N, or a reward, may have."""

DAMAGE = (
    OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError, MemoryError,
)  # fmt: skip
"""What reading a damaged file can raise, ``RecursionError`` among the ``RuntimeError``s."""


def fill_from_log(replay: Replay, path: Path, action_size: int) -> None:
    """Fill the replay memory with a dataset directory, as ``minitouch-bench record`` writes it.

    The dataset is a stranger's: its shapes are looked at before anything is unpacked, and nothing
    outside the file is read. Minari itself would follow the file's links.

    Raises:
        MissingExtraError: h5py is not installed.
        UsageError: there is no such dataset, it is of another environment, damaged or larger
            than the memory.
    """
    for episode in _read_episodes(path, action_size):
        if replay.rows + len(episode.images) > replay.capacity:
            raise UsageError(
                f"{path} contains more than the {replay.capacity:,} steps of the memory: "
                "set a larger replay_size"
            )
        episode.add_to(replay)
    if not replay.rows:
        raise UsageError(f"{path} contains no control step")


@dataclass(frozen=True)
class _Episode:
    """The checked arrays of an episode of T steps: T + 1 images and touch vectors, T of others."""

    images: NDArray[np.uint8]
    touch: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    successes: NDArray[np.bool_]
    ends: NDArray[np.bool_]

    def add_to(self, replay: Replay) -> None:
        replay.begin_episode(self.images[0], self.touch[0])
        for step, action in enumerate(self.actions):
            replay.add(
                action,
                float(self.rewards[step]),
                self.images[step + 1],
                self.touch[step + 1],
                success=bool(self.successes[step]),
                ended=bool(self.ends[step]),
            )


def _read_episodes(path: Path, action_size: int) -> Iterator[_Episode]:
    h5py = require("h5py", "data")
    try:
        count = _count_episodes(path)
        handle = open_plain(path / DATA_FILE, os.O_RDONLY, follow=True)
        with os.fdopen(handle, "rb") as plain, h5py.File(plain, "r") as file:
            if len(file) != count:
                raise ValueError(f"{METADATA_FILE} counts {count} episodes, the data {len(file)}")
            for index in range(count):
                yield _Reader(h5py, file, f"episode_{index}").read(action_size)
    except DAMAGE as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UsageError(f"{path} is not a Minari dataset of this task: {reason}") from error


def _count_episodes(path: Path) -> int:
    metadata = json.loads(read_file(path / METADATA_FILE, MIB, follow=True))
    if not isinstance(metadata, dict) or metadata.get("data_format", "hdf5") != "hdf5":
        raise ValueError(f"{METADATA_FILE} does not say that the data are HDF5")
    count = metadata.get("total_episodes")
    if type(count) is not int:
        raise ValueError(f"{METADATA_FILE} does not count the episodes")
    return count


class _Reader:
    """Reads the arrays of one episode, each with the shape that it must have."""

    def __init__(self, h5py: Any, file: Any, name: str) -> None:
        self._h5py = h5py
        self._name = name
        self._group = self._member(file, name, h5py.Group)

    def read(self, action_size: int) -> _Episode:
        """Return the episode, every number of it checked."""
        observations = self._member(self._group, "observations", self._h5py.Group)
        given = self._member(self._group, "actions", self._h5py.Dataset).shape
        steps = given[0] if given else 0
        if given != (steps, action_size) or not 0 < steps <= LONGEST_EPISODE:
            raise ValueError(
                f"{self._name} has actions {given}; wanted are 1 to {LONGEST_EPISODE:,} of "
                f"{action_size} numbers"
            )
        images = self._array(observations, "image", (steps + 1, *IMAGE_SHAPE))
        if images.dtype != np.uint8:
            raise ValueError(f"{self._name} has images of {images.dtype}, not uint8")
        touch = self._numbers(observations, "touch", (steps + 1, *TOUCH_SHAPE), LARGEST_VALUE)
        rewards = self._numbers(self._group, "rewards", (steps,), LARGEST_VALUE)
        return _Episode(
            images,
            touch.astype(np.float32),
            self._numbers(self._group, "actions", given, 1.0).astype(np.float32),
            rewards,
            self._successes(rewards > 0),
            self._numbers(self._group, "terminations", (steps,), 1.0) > 0,
        )

    def _successes(self, rewarded: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return whether each step reached the goal, (T,): what ``is_success`` in the infos says.

        Without it a step did that has a positive reward. Rewards of another kind need
        ``is_success``; its first value is the reset's, if there is one more than steps.
        """
        if "infos" not in self._group:
            return rewarded
        infos = self._member(self._group, "infos", self._h5py.Group)
        if "is_success" not in infos:
            return rewarded
        length = self._member(infos, "is_success", self._h5py.Dataset).shape
        steps = len(rewarded)
        shape = (steps + 1,) if length == (steps + 1,) else (steps,)
        return self._numbers(infos, "is_success", shape, 1.0)[-steps:] > 0

    def _numbers(
        self, group: Any, name: str, shape: tuple[int, ...], largest: float
    ) -> NDArray[np.float64]:
        """Return finite numbers of at most a size, float64."""
        array = self._array(group, name, shape)
        if array.dtype.kind not in "fiub":
            raise ValueError(f"{self._name} has {name} of {array.dtype}")
        numbers = array.astype(np.float64)
        if not (np.abs(numbers) <= largest).all():  # NaN is not
            raise ValueError(f"{self._name} has {name} that are not numbers within ±{largest:g}")
        return numbers

    def _array(self, group: Any, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """Read an array whose shape is the one wanted; its chunks are not larger than allowed."""
        data = self._member(group, name, self._h5py.Dataset)
        if data.shape != shape:
            raise ValueError(f"{self._name} has {name} {data.shape}; wanted is {shape}")
        if data.dtype.hasobject or data.is_virtual or data.external:
            raise ValueError(f"{self._name} has {name} that are stored elsewhere")
        chunk = np.prod(data.chunks or (0,), dtype=np.float64) * data.dtype.itemsize
        if chunk > LARGEST_CHUNK:
            raise ValueError(f"{self._name} has {name} in chunks of {chunk:.0f} bytes")
        array: NDArray[Any] = data[()]
        return array

    def _member(self, group: Any, name: str, kind: Any) -> Any:
        """Return a member that lies in the file itself."""
        link = group.get(name, getlink=True)
        if link is None:
            raise ValueError(f"{self._name} has no {name.removeprefix(self._name)}".rstrip())
        if not isinstance(link, self._h5py.HardLink):
            raise ValueError(f"{self._name} has {name} that is a link")
        member = group[name]
        if not isinstance(member, kind):
            raise ValueError(f"{self._name} has {name} of another kind")
        return member
