"""``minitouch-bench train``: what it shows while it runs, and prints."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from minitouch_bench.cli.console import LINE_INTERVAL_S, notes
from minitouch_bench.workflows import TrainingProgress

if TYPE_CHECKING:
    from minitouch_bench.agents.progress import ProgressRow


def show_directory(directory: Path) -> None:
    """Print the training's directory."""
    print(directory)


@contextmanager
def training_progress() -> Iterator[TrainingProgress]:
    """Show a training on the screen, and end it between two steps after a Ctrl-C."""
    with _interrupts() as interrupts, _TrainingBar() as bar:
        yield TrainingProgress(
            note=lambda text: notes.print(text, markup=False),
            begin=bar.begin,
            row=bar.show,
            should_stop=lambda: bool(interrupts),
        )


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Collect Ctrl-C, so that a training ends between two steps; a second one ends it at once."""
    seen: list[int] = []

    def note(number: int, _: object) -> None:
        if seen:
            raise KeyboardInterrupt
        seen.append(number)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, before)


class _TrainingBar(Progress):
    """Steps done, what they showed since the last row, and the time left.

    Where there is no terminal, one line per minute says so.
    """

    def __init__(self) -> None:
        super().__init__(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=20),
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            TextColumn("{task.fields[figures]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=notes,
            refresh_per_second=2,
            speed_estimate_period=600,
        )
        self._steps, self._told_at = 0, time.monotonic()

    def begin(self, steps: int) -> None:
        """Take the control steps of both phases."""
        self._bar = self.add_task("training", total=steps, figures="")
        self._steps = steps

    def show(self, row: "ProgressRow") -> None:
        """Show a row of ``progress.csv``."""
        figures = {
            "curiosity": row.intrinsic_reward,
            "reward": row.task_reward,
            "touch": row.touch_share,
            "success": row.success,
        }
        text = "  ".join(
            f"{name} {value:.2f}" for name, value in figures.items() if value is not None
        )
        self.update(self._bar, completed=row.step, description=row.phase, figures=text)
        if not notes.is_terminal and time.monotonic() >= self._told_at + LINE_INTERVAL_S:
            self._told_at = time.monotonic()
            notes.print(f"{row.phase}: {row.step:,} of {self._steps:,} control steps  {text}")
