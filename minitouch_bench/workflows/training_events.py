"""TensorBoard events of a training, beside its ``progress.csv``."""

from dataclasses import asdict
from pathlib import Path

from minitouch_bench.agents.progress import ProgressRow
from minitouch_bench.optional import require

EVENTS_DIRECTORY = "events"


class EventWriter:
    """Write every number of a row as a scalar at its control step."""

    def __init__(self, directory: Path) -> None:
        """Open a new file of events.

        Raises:
            MissingExtraError: tensorboardX is not installed.
        """
        tensorboard = require("tensorboardX", "train")
        self._writer = tensorboard.SummaryWriter(str(directory / EVENTS_DIRECTORY))

    def add(self, row: ProgressRow) -> None:
        """Write a row."""
        for name, value in asdict(row).items():
            if name != "step" and isinstance(value, float | int):
                self._writer.add_scalar(f"{row.phase}/{name}", value, row.step)
        self._writer.flush()

    def close(self) -> None:
        """Close the file."""
        self._writer.close()
