"""What a training tells of itself: rows of ``progress.csv``."""

import csv
import io
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from torch import Tensor

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import append_bytes, read_file, write_file


@dataclass(frozen=True)
class ProgressRow:
    """The control steps since the row before; None where there is nothing to tell.

    ``intrinsic_reward``: mean over the batches, as learned from; ``task_reward``: the task's
    own, per control step; ``touch_share``: share of control steps in contact; ``success``:
    share of the ``episodes`` that ended. ``value`` is the critic's mean, ``entropy`` in
    nats. ``evaluation_*``: on episodes of their own, see ``evaluate_every`` in
    ``agents/config.py``.
    """

    step: int
    phase: str
    episodes: int
    intrinsic_reward: float | None
    task_reward: float | None
    touch_share: float | None
    success: float | None
    curiosity_loss: float | None
    critic_loss: float | None
    actor_loss: float | None
    value: float | None
    entropy: float | None
    temperature: float | None
    evaluation_success: float | None
    evaluation_touch_share: float | None
    seconds: float


COLUMNS = tuple(field.name for field in fields(ProgressRow))
LOSSES = (
    "intrinsic_reward",
    "curiosity_loss",
    "critic_loss",
    "actor_loss",
    "value",
    "entropy",
    "temperature",
)


@dataclass(frozen=True)
class Evaluation:
    """Shares over the episodes of one evaluation."""

    success: float
    touch_share: float


class Tally:
    """Sums since the last row."""

    def __init__(self) -> None:
        self.steps = self.touched = self.episodes = self.successes = self.updates = 0
        self.task_reward = 0.0
        self.losses: dict[str, Tensor] = {}

    def add_step(self, reward: float, *, success: bool, touched: bool, ended: bool) -> None:
        """Count a control step."""
        self.steps += 1
        self.touched += touched
        self.task_reward += reward
        self.episodes += ended
        self.successes += success

    def add_losses(self, losses: dict[str, Tensor]) -> None:
        """Count a gradient step, without waiting for the device."""
        self.updates += 1
        for name, value in losses.items():
            self.losses[name] = self.losses[name] + value if name in self.losses else value

    def row(
        self, step: int, phase: str, evaluation: Evaluation | None, seconds: float
    ) -> ProgressRow:
        """Return the row that these sums make."""
        means = {
            name: float(self.losses[name]) / self.updates if name in self.losses else None
            for name in LOSSES
        }
        return ProgressRow(
            step=step,
            phase=phase,
            episodes=self.episodes,
            task_reward=self.task_reward / self.steps if self.steps else None,
            touch_share=self.touched / self.steps if self.steps else None,
            success=self.successes / self.episodes if self.episodes else None,
            evaluation_success=evaluation.success if evaluation else None,
            evaluation_touch_share=evaluation.touch_share if evaluation else None,
            seconds=round(seconds, 1),
            **means,
        )


def append_row(path: Path, row: ProgressRow) -> None:
    """Add a row to a CSV file, with the names of the columns above the first.

    Raises:
        RunDirectoryError: there is no room, or no permission.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    if not os.path.lexists(path):
        writer.writeheader()
    writer.writerow({n: "" if v is None else v for n, v in asdict(row).items()})
    append_bytes(path, text.getvalue().encode())


def cut_rows(path: Path, step: int) -> None:
    """Drop the rows after a step, which will be written again, and the file with the last row.

    Raises:
        RunDirectoryError: the file cannot be read, or a row has no step.
    """
    if not os.path.lexists(path):
        return
    try:
        lines = read_file(path).decode().splitlines(keepends=True)
        rows = [line for line in lines[1:] if line.endswith("\n")]
        kept = [row for row in rows if int(row.partition(",")[0]) <= step]
    except (OSError, ValueError) as error:
        raise RunDirectoryError(f"{path} cannot be read: {error}") from error
    if kept:
        write_file(path, "".join([lines[0], *kept]))
    else:
        path.unlink()
