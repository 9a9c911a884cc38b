"""Replay memory, whose sampler computes rewards; and the checkpoint of a training.

From a checkpoint a killed training continues bit for bit. ``replay.bin`` grows by the images since
the last checkpoint. ``checkpoint.pt`` contains everything else, and the length that ``replay.bin``
had: what a later kill left behind that is cut off.
"""

import io
import os
import zipfile
import zlib
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import damage_as, open_plain, os_errors_as, write_file

COMPRESSION_LEVEL = 6
"""Of zlib: an image takes 60 to 90 microseconds in, 20 out, and 300 to 800 of 7,056 bytes."""

PLAIN_ROWS = 65_536
"""How many of the newest images are kept unpacked, too: 0.46 GB, taken as they come."""

ENCODED_AT_ONCE = 256
"""Images."""

SUCCESS_STEPS = 50
"""How many of the last steps before a success count as leading to it."""

_COLUMNS = ("_touch", "_action", "_reward", "_ended", "_last", "_led_to_success", "_features")


@dataclass(frozen=True)
class Batch:
    """N transitions on the learner's device, ``n_step`` control steps long.

    ``image``, ``next_image`` uint8 (N, 1, H, W), or the features kept of them, float32 (N, F);
    ``touch``, ``next_touch`` float32 (N, 11), as the environment gives them; ``action`` float32
    (N, A);
    ``task_reward`` float32 (N,), discounted and summed over the steps; ``discount`` float32 (N,),
    what a value of the reached state counts; ``ended`` bool (N,), whether the episode ended there
    for good.
    """

    image: Tensor
    touch: Tensor
    action: Tensor
    next_image: Tensor
    next_touch: Tensor
    task_reward: Tensor
    discount: Tensor
    ended: Tensor


class ReplayMemory:
    """What happened, row by row: an image, its touch, and the action that followed.

    An episode of T control steps fills T + 1 rows; the last one has no action. Rows are
    numbered from the first ever added; the oldest leave when ``capacity`` is reached.
    """

    def __init__(
        self, capacity: int, touch_size: int, action_size: int, features_size: int = 0
    ) -> None:
        self.capacity = capacity
        self._images: dict[int, bytes] = {}
        self._plain = np.zeros(0, np.uint8)
        # Memory is taken where it is written to.
        self._touch = np.zeros((capacity, touch_size), np.float32)
        self._action = np.zeros((capacity, action_size), np.float32)
        self._reward = np.zeros(capacity, np.float32)
        self._ended = np.zeros(capacity, np.bool_)
        self._last = np.zeros(capacity, np.bool_)
        self._led_to_success = np.zeros(capacity, np.bool_)
        self._features = np.zeros((capacity, features_size), np.float32)
        self._encoded = 0
        self._image_shape: tuple[int, ...] = ()
        self._episode_start = 0
        self.rows = 0

    def __len__(self) -> int:
        """Return how many rows are held."""
        return min(self.rows, self.capacity)

    def begin_episode(self, image: NDArray[np.uint8], touch: NDArray[np.float32]) -> None:
        """Add the observation of a reset."""
        self._episode_start = self.rows
        self._append(image, touch)

    def add(
        self,
        action: NDArray[np.float32],
        reward: float,
        image: NDArray[np.uint8],
        touch: NDArray[np.float32],
        *,
        success: bool,
        ended: bool,
    ) -> None:
        """Add an action, the task's reward for it, and the observation it led to.

        ``success``: the task's goal was reached there. ``ended``: the episode ended there for
        good, not by its step limit.
        """
        row = (self.rows - 1) % self.capacity
        self._action[row] = action
        self._reward[row] = reward
        self._ended[row] = ended
        self._last[row] = False
        self._append(image, touch)
        if success:
            start = max(self._episode_start, self.rows - 1 - SUCCESS_STEPS)
            self._led_to_success[np.arange(start, self.rows - 1) % self.capacity] = True

    def _append(self, image: NDArray[np.uint8], touch: NDArray[np.float32]) -> None:
        row = self.rows % self.capacity
        self._images[row] = zlib.compress(image.tobytes(), COMPRESSION_LEVEL)
        self._image_shape = image.shape
        self._keep_plain(self.rows, image)
        self._touch[row] = touch
        self._last[row] = True
        self._led_to_success[row] = False
        self.rows += 1

    def encode(self, encode: Callable[[Tensor, Tensor], Tensor]) -> None:
        """Keep the features of each observation that has none yet.

        ``encode`` maps images uint8 (N, 1, H, W) and touch float32 (N, 11) to features float32
        (N, F). They are kept, because the same image can have other bits in a larger batch.
        """
        self._encoded = max(self._encoded, self.rows - len(self))
        while self._encoded < self.rows:
            rows = np.arange(self._encoded, min(self._encoded + ENCODED_AT_ONCE, self.rows))
            touch = torch.from_numpy(self._touch[rows % self.capacity])
            features = encode(torch.from_numpy(self._unpacked(rows)), touch)
            self._features[rows % self.capacity] = features.numpy(force=True)
            self._encoded += len(rows)

    def _keep_plain(self, row: int, image: NDArray[np.uint8]) -> None:
        if not len(self._plain):  # memory that is taken where it is written to
            self._plain = np.empty((min(self.capacity, PLAIN_ROWS), *image.shape), np.uint8)
        self._plain[row % len(self._plain)] = image

    def sample(
        self,
        rng: np.random.Generator,
        size: int,
        *,
        n_step: int,
        discount: float,
        success_share: float,
        device: torch.device,
        encoded: bool = False,
    ) -> Batch:
        """Draw a batch of transitions, uniformly where enough of them led to a success.

        Where they are fewer than ``success_share`` of the memory, more of them are drawn, so that
        they are that share of the batch. ``encoded``: with the features in place of the images.
        """
        starts = self._draw(rng, size)
        self._draw_successes(rng, starts, success_share)
        rows = starts.copy()
        reward, factor = np.zeros(size, np.float32), np.ones(size, np.float32)
        alive, ended = np.ones(size, np.bool_), np.zeros(size, np.bool_)
        for _ in range(n_step):
            at = rows % self.capacity
            alive &= ~self._last[at]
            reward += np.where(alive, factor * self._reward[at], 0.0)
            factor = np.where(alive, factor * np.float32(discount), factor)
            ended |= alive & self._ended[at]
            rows += alive
        now, then = starts % self.capacity, rows % self.capacity
        both = np.concatenate((starts, rows))
        seen = self._features[both % self.capacity] if encoded else self._unpacked(both)
        image, next_image = _tensor(seen, device).chunk(2)
        return Batch(
            image=image,
            touch=_tensor(self._touch[now], device),
            action=_tensor(self._action[now], device),
            next_image=next_image,
            next_touch=_tensor(self._touch[then], device),
            task_reward=_tensor(reward, device),
            discount=_tensor(factor, device),
            ended=_tensor(ended, device),
        )

    def sample_observations(self, rng: np.random.Generator, size: int) -> tuple[Tensor, Tensor]:
        """Draw observations uniformly: images uint8 (N, 1, H, W), touch float32 (N, 11)."""
        rows = rng.integers(self.rows - len(self), self.rows, size)
        images, touch = self._unpacked(rows), self._touch[rows % self.capacity]
        return torch.from_numpy(images), torch.from_numpy(touch)

    def _draw(self, rng: np.random.Generator, size: int) -> NDArray[np.int64]:
        """Draw rows that an action followed; the newest row has none yet."""
        oldest = self.rows - len(self)
        rows = rng.integers(oldest, self.rows - 1, size)
        while (bad := self._last[rows % self.capacity]).any():
            rows[bad] = rng.integers(oldest, self.rows - 1, int(bad.sum()))
        return rows

    def _draw_successes(
        self, rng: np.random.Generator, rows: NDArray[np.int64], share: float
    ) -> None:
        """Replace the first rows by such that led to a success, as many as ``share`` lacks."""
        found = np.flatnonzero(self._led_to_success[: len(self)])
        natural = len(found) / len(self)
        if 0.0 < natural < share:
            lacking = int((share - natural) / (1.0 - natural) * len(rows))
            # Rows are numbered from the first ever added, places from the memory's first.
            places = found[rng.integers(len(found), size=lacking)]
            newest = self.rows - 1
            rows[:lacking] = newest - (newest - places) % self.capacity

    def _unpacked(self, rows: NDArray[np.int64]) -> NDArray[np.uint8]:
        images = self._plain[rows % len(self._plain)]
        for index in np.flatnonzero(rows < self.rows - len(self._plain)):
            images[index] = self._unpack(self._images[rows[index] % self.capacity])
        return images

    def _unpack(self, content: bytes) -> NDArray[np.uint8]:
        return np.frombuffer(zlib.decompress(content), np.uint8).reshape(self._image_shape)

    def state(self) -> dict[str, Any]:
        """Return everything but the images."""
        size = len(self)
        lengths = [len(self._images[row]) for row in range(size)]
        return {
            "rows": self.rows,
            "episode_start": self._episode_start,
            "image_shape": self._image_shape,
            "encoded": self._encoded,
            "lengths": torch.tensor(lengths, dtype=torch.int32),
            **{name: torch.from_numpy(getattr(self, name)[:size]) for name in _COLUMNS},
        }

    def images_since(self, row: int) -> bytes:
        """Return the images from a row on, one after the other, as they are kept."""
        return b"".join(self._images[index % self.capacity] for index in range(row, self.rows))

    def load(self, state: dict[str, Any], images: bytes) -> None:
        """Take over what ``state`` returned, and the ``images`` of all rows that are held.

        Raises:
            ValueError, LookupError, zlib.error: the state or an image is damaged.
        """
        self.rows, self._episode_start = state["rows"], state["episode_start"]
        self._image_shape, self._encoded = state["image_shape"], state["encoded"]
        lengths, end, size = state["lengths"].tolist(), 0, len(self)
        for name in _COLUMNS:
            getattr(self, name)[:size] = state[name]
        for row in range(self.rows - size, self.rows):
            content = images[end : end + lengths[row % self.capacity]]
            self._images[row % self.capacity] = content
            self._keep_plain(row, self._unpack(content))
            end += len(content)

    def episode_actions(self) -> NDArray[np.float32]:
        """Return the actions of the episode under way, float32 (T, A)."""
        return self._action[np.arange(self._episode_start, self.rows - 1) % self.capacity]


def _tensor(array: NDArray[Any], device: torch.device) -> Tensor:
    return torch.from_numpy(array).to(device)


# Checkpoints

CHECKPOINT_FILE = "checkpoint.pt"
IMAGES_FILE = "replay.bin"

CHECKPOINT_VERSION = 4
"""Changes with the meaning of what a checkpoint contains; only this version is resumed."""


class CheckpointFiles:
    """The two files of a training's checkpoint, in its directory."""

    def __init__(self, directory: Path) -> None:
        self._file = directory / CHECKPOINT_FILE
        self._images = directory / IMAGES_FILE
        self._rows = self._length = 0

    def exists(self) -> bool:
        """Tell whether there is a checkpoint."""
        return os.path.lexists(self._file)

    def save(self, state: dict[str, Any], memory: ReplayMemory) -> None:
        """Write a checkpoint; the last one stays whole until this one is.

        Raises:
            RunDirectoryError: there is no room, or no permission.
        """
        fresh = memory.images_since(max(self._rows, memory.rows - len(memory)))
        with (
            os_errors_as(RunDirectoryError, self._images, "written"),
            os.fdopen(open_plain(self._images, os.O_RDWR | os.O_CREAT), "r+b") as file,
        ):
            file.seek(self._length)
            file.truncate()
            file.write(fresh)
            file.flush()
            os.fsync(file.fileno())
        self._rows, self._length = memory.rows, self._length + len(fresh)
        whole = {"version": CHECKPOINT_VERSION, "images": self._length, "replay": memory.state()}
        content = io.BytesIO()
        torch.save({**whole, **state}, content)
        write_file(self._file, content.getvalue())

    def load(self, memory: ReplayMemory) -> dict[str, Any]:
        """Fill the replay memory and return the rest of the state.

        Raises:
            RunDirectoryError: the checkpoint is missing, damaged or of another version.
        """
        with self.damage_named():
            with os.fdopen(open_plain(self._file, os.O_RDONLY), "rb") as file:
                with zipfile.ZipFile(file) as archive:
                    if (part := archive.testzip()) is not None:  # torch does not check the sums
                        raise ValueError(f"its part {part} is damaged")
                file.seek(0)
                state: dict[str, Any] = torch.load(file, map_location="cpu", weights_only=True)
            if (version := state.pop("version", None)) != CHECKPOINT_VERSION:
                raise ValueError(f"it has version {version}, not {CHECKPOINT_VERSION}: train again")
            self._length, replay = state.pop("images"), state.pop("replay")
            size = int(replay["lengths"].sum())
            with os.fdopen(open_plain(self._images, os.O_RDONLY), "rb") as file:
                file.seek(self._length - size)
                memory.load(replay, file.read(size))
        self._rows = memory.rows
        return state

    def damage_named(self) -> AbstractContextManager[None]:
        """Raise what damage causes in a block as a RunDirectoryError that names the file."""
        return damage_as(RunDirectoryError, f"{self._file} cannot be resumed from")
