"""A training's checkpoint, from which a killed training continues bit for bit.

``replay.bin`` grows by the images since the last checkpoint. ``checkpoint.pt`` contains everything
else, and the length that ``replay.bin`` had: what a later kill left behind that is cut off.
"""

import io
import os
import zipfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import torch

from minitouch_bench.agents.replay import Replay
from minitouch_bench.errors import MiniTouchError, RunDirectoryError
from minitouch_bench.files import (
    LARGEST_CHECKPOINT,
    open_plain,
    os_errors_as,
    read_file,
    write_file,
)

CHECKPOINT_FILE = "checkpoint.pt"
IMAGES_FILE = "replay.bin"

CHECKPOINT_VERSION = 3
"""Changes with the meaning of what a checkpoint contains; only this version is resumed."""


@contextmanager
def damage_as(kind: type[MiniTouchError], what: str) -> Iterator[None]:
    """Raise what reading a damaged file causes in a block as an error that says "WHAT: why"."""
    try:
        yield
    except (MiniTouchError, ImportError, MemoryError):
        raise
    except Exception as error:  # what torch, zipfile, pickle and Minari raise has no common root
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise kind(f"{what}: {reason}") from error


class CheckpointFiles:
    """The two files of a training's checkpoint, in its directory."""

    def __init__(self, directory: Path) -> None:
        self._file = directory / CHECKPOINT_FILE
        self._images = directory / IMAGES_FILE
        self._rows = self._length = 0

    def exists(self) -> bool:
        """Tell whether there is a checkpoint."""
        return os.path.lexists(self._file)

    def save(self, state: dict[str, Any], replay: Replay) -> None:
        """Write a checkpoint; the last one stays whole until this one is.

        Raises:
            RunDirectoryError: there is no room, or no permission.
        """
        fresh = replay.images_since(max(self._rows, replay.rows - len(replay)))
        with (
            os_errors_as(RunDirectoryError, self._images, "written"),
            os.fdopen(open_plain(self._images, os.O_RDWR | os.O_CREAT), "r+b") as file,
        ):
            file.seek(self._length)
            file.truncate()
            file.write(fresh)
            file.flush()
            os.fsync(file.fileno())
        self._rows, self._length = replay.rows, self._length + len(fresh)
        whole = {"version": CHECKPOINT_VERSION, "images": self._length, "replay": replay.state()}
        content = io.BytesIO()
        torch.save({**whole, **state}, content)
        write_file(self._file, content.getvalue())

    def load(self, replay: Replay) -> dict[str, Any]:
        """Fill the replay memory and return the rest of the state.

        Raises:
            RunDirectoryError: the checkpoint is missing, damaged or of another version.
        """
        with self.damage_named():
            content = io.BytesIO(read_file(self._file, LARGEST_CHECKPOINT))
            with zipfile.ZipFile(content) as archive:
                if (part := archive.testzip()) is not None:  # torch does not check the sums
                    raise ValueError(f"its part {part} is damaged")
                if any(one.file_size != one.compress_size for one in archive.infolist()):
                    raise ValueError("its parts are compressed: they could take any memory")
            content.seek(0)
            state: dict[str, Any] = torch.load(content, map_location="cpu", weights_only=True)
            if (version := state.pop("version", None)) != CHECKPOINT_VERSION:
                raise ValueError(f"it has version {version}, not {CHECKPOINT_VERSION}: train again")
            self._length = state.pop("images")
            replay.load(state.pop("replay"), self._read_images)
        self._rows = replay.rows
        return state

    def _read_images(self, size: int) -> bytes:
        """Return the last ``size`` bytes of the images that the checkpoint counts."""
        with os.fdopen(open_plain(self._images, os.O_RDONLY), "rb") as file:
            file.seek(self._length - size)
            return file.read(size)

    def damage_named(self) -> AbstractContextManager[None]:
        """Raise what damage causes in a block as a RunDirectoryError that names the file."""
        return damage_as(RunDirectoryError, f"{self._file} cannot be resumed from")
