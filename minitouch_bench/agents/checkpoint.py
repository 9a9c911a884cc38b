"""A training's checkpoint: what a killed training goes on from, bit for bit.

``replay.bin`` grows by the images since the checkpoint before; ``checkpoint.pt`` holds
everything else and how long ``replay.bin`` was, so that what a later kill left behind it is
cut off.
"""

import io
import os
import pickle
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor

from minitouch_bench.agents.replay import Replay
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import GIB, open_plain, os_errors_as, write_file
from minitouch_bench.policies.policy import IMAGE_SHAPE

DAMAGE = (
    OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError, EOFError,
    ArithmeticError, AssertionError, pickle.UnpicklingError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What reading a damaged file can raise."""

CHECKPOINT_FILE = "checkpoint.pt"
PICTURES_FILE = "replay.bin"

LARGEST_CHECKPOINT = GIB
"""The most bytes of ``checkpoint.pt``: a million steps take a tenth of it."""


class CheckpointFiles:
    """The two files of a training's checkpoint, in its directory."""

    def __init__(self, directory: Path) -> None:
        self._file = directory / CHECKPOINT_FILE
        self._images = directory / PICTURES_FILE
        self._rows = self._length = 0

    def exists(self) -> bool:
        """Tell whether there is a checkpoint."""
        return os.path.lexists(self._file)

    def save(self, state: dict[str, Any], replay: Replay) -> None:
        """Write a checkpoint; one before it stays whole until this one is.

        Raises:
            RunDirectoryError: there is no room, or no permission.
        """
        fresh = replay.images_since(max(self._rows, replay.rows - len(replay)))
        with os_errors_as(RunDirectoryError, self._images, "written"):
            self._append(fresh)
        self._rows, self._length = replay.rows, self._length + len(fresh)
        content = io.BytesIO()
        torch.save({**state, "replay": replay.state(), "images": self._length}, content)
        write_file(self._file, content.getvalue())

    def _append(self, images: bytes) -> None:
        """Write images behind those of the checkpoint before."""
        with os.fdopen(open_plain(self._images, os.O_RDWR | os.O_CREAT), "r+b") as file:
            file.seek(self._length)
            file.truncate()
            file.write(images)
            file.flush()
            os.fsync(file.fileno())

    def load(self, replay: Replay) -> dict[str, Any]:
        """Fill the replay memory and return the rest of the state.

        Nothing in the files is believed: they are read as data only, within limits.

        Raises:
            RunDirectoryError: the checkpoint is missing or damaged.
        """
        with self.damage_named():
            with os.fdopen(open_plain(self._file, os.O_RDONLY), "rb") as file:
                _refuse_archive(file)
                file.seek(0)
                state: dict[str, Any] = torch.load(file, map_location="cpu", weights_only=True)
            self._length = state.pop("images")
            kept = state.pop("replay")
            if kept["rows"] and tuple(kept["image_shape"]) != IMAGE_SHAPE:
                raise ValueError("its images have another shape")
            replay.load(kept, self._read_images)
        self._rows = replay.rows
        return state

    def _read_images(self, held: int) -> bytes:
        """Return the last bytes of the images that the checkpoint counts."""
        with os.fdopen(open_plain(self._images, os.O_RDONLY), "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if not held <= self._length <= size:
                raise EOFError(f"{self._images.name} is too short")
            file.seek(self._length - held)
            return file.read(held)

    @contextmanager
    def damage_named(self) -> Iterator[None]:
        """Raise what a damaged checkpoint causes as an error that names it.

        Raises:
            RunDirectoryError: the block failed.
        """
        try:
            yield
        except DAMAGE as error:
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise RunDirectoryError(f"{self._file} cannot be resumed from: {reason}") from error


def _refuse_archive(file: BinaryIO) -> None:
    """Refuse an archive that is damaged, or that unpacks to more than it is.

    Raises:
        ValueError, zipfile.BadZipFile: it is one.
    """
    if os.fstat(file.fileno()).st_size > LARGEST_CHECKPOINT:
        raise ValueError(f"it is larger than {LARGEST_CHECKPOINT // GIB} GiB")
    with zipfile.ZipFile(file) as archive:
        if any(part.compress_type != zipfile.ZIP_STORED for part in archive.infolist()):
            raise ValueError("it is packed")
        if (damaged := archive.testzip()) is not None:
            raise ValueError(f"its part {damaged} is damaged")


def refuse_other_form(state: object, sound: object, where: str = "") -> None:
    """Refuse a state whose keys, types and shapes are not those of a sound one.

    What a sound one has no entries for yet, such as an optimizer's state, may hold any tensors of
    their own memory.

    Raises:
        ValueError: the text names the part.
    """
    if isinstance(sound, Tensor) and isinstance(state, Tensor):
        same = state.dtype == sound.dtype and state.shape == sound.shape
        if not same or state.nbytes > state.untyped_storage().nbytes():
            raise ValueError(f"{where} has another form")
    elif type(state) is not type(sound):
        raise ValueError(f"{where} is of another type")
    elif isinstance(state, dict) and isinstance(sound, dict):
        if sound and state.keys() != sound.keys():
            raise ValueError(f"{where} has other keys")
        for key, value in state.items():
            refuse_other_form(value, sound.get(key, value), f"{where} {key}".strip())
    elif isinstance(state, list | tuple) and isinstance(sound, list | tuple):
        if len(state) != len(sound):
            raise ValueError(f"{where} has another length")
        for index, value in enumerate(state):
            refuse_other_form(value, sound[index], f"{where} {index}".strip())
