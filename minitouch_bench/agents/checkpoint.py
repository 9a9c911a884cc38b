"""A training's checkpoint: what a killed training goes on from, bit for bit.

``replay.bin`` grows by the pictures since the checkpoint before; ``checkpoint.pt`` holds
everything else and how long ``replay.bin`` was, so that what a later kill left behind it is
cut off.
"""

import io
import os
import pickle
from pathlib import Path
from typing import Any

import torch

from minitouch_bench.agents.replay import Replay
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import os_errors_as, write_file

DAMAGE = (
    OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError, EOFError,
    pickle.UnpicklingError,
)  # fmt: skip
"""What reading a damaged file can raise."""

CHECKPOINT_FILE = "checkpoint.pt"
PICTURES_FILE = "replay.bin"


class CheckpointFiles:
    """The two files of a training's checkpoint, in its directory."""

    def __init__(self, directory: Path) -> None:
        self._file = directory / CHECKPOINT_FILE
        self._pictures = directory / PICTURES_FILE
        self._rows = self._length = 0

    def exists(self) -> bool:
        """Tell whether there is a checkpoint."""
        return self._file.exists()

    def save(self, state: dict[str, Any], replay: Replay) -> None:
        """Write a checkpoint; one before it stays whole until this one is.

        Raises:
            RunDirectoryError: there is no room, or no permission.
        """
        fresh = replay.pictures_since(max(self._rows, replay.rows - len(replay)))
        with os_errors_as(RunDirectoryError, self._pictures, "written"):
            self._append(fresh)
        self._rows, self._length = replay.rows, self._length + len(fresh)
        content = io.BytesIO()
        torch.save({**state, "replay": replay.state(), "pictures": self._length}, content)
        write_file(self._file, content.getvalue())

    def _append(self, pictures: bytes) -> None:
        """Write pictures behind those of the checkpoint before."""
        with self._pictures.open("r+b" if self._length else "wb") as file:
            file.seek(self._length)
            file.truncate()
            file.write(pictures)
            file.flush()
            os.fsync(file.fileno())

    def load(self, replay: Replay) -> dict[str, Any]:
        """Fill the replay memory and return the rest of the state.

        Raises:
            RunDirectoryError: the checkpoint is missing or damaged.
        """
        try:
            state: dict[str, Any] = torch.load(self._file, map_location="cpu", weights_only=True)
            self._length = state.pop("pictures")
            kept = state.pop("replay")
            held = int(kept["lengths"].sum())
            with self._pictures.open("rb") as file:
                file.seek(self._length - held)
                pictures = file.read(held)
            if len(pictures) < held:
                raise EOFError(f"{self._pictures.name} is too short")
            replay.load(kept, pictures)
        except DAMAGE as error:
            raise RunDirectoryError(f"{self._file} cannot be resumed from: {error}") from error
        self._rows = replay.rows
        return state
