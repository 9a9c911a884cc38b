"""``minitouch-bench train``: a learner, from nothing to a checkpoint."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from minitouch_bench.agents.curiosity import METHODS
from minitouch_bench.cli.console import LINE_INTERVAL_S, notes
from minitouch_bench.errors import InterruptedRunError
from minitouch_bench.protocol.minitouch import TASK_NAMES

if TYPE_CHECKING:
    from minitouch_bench.agents.progress import ProgressRow


def train(
    task: Annotated[str, typer.Argument(metavar="TASK", help=", ".join(TASK_NAMES))],
    *,
    method: Annotated[
        str | None, typer.Option(help=f"{', '.join(METHODS)}; by default hac.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Fixes every random draw; by default 0.")
    ] = None,
    exploration_steps: Annotated[
        int | None, typer.Option(min=0, help="Control steps on the intrinsic reward alone.")
    ] = None,
    task_steps: Annotated[
        int | None, typer.Option(min=0, help="Control steps on the task's reward after them.")
    ] = None,
    objects: Annotated[
        str | None,
        typer.Option(help="cube, or shapes to draw from: train, all. Default: the task's."),
    ] = None,
    from_log: Annotated[
        Path | None,
        typer.Option(help="Explore this recorded dataset (Minari's) in place of the world."),
    ] = None,
    preset: Annotated[
        str, typer.Option(help="default (what learns best here) or paper (Tables 2 and 3).")
    ] = "default",
    config: Annotated[
        Path | None, typer.Option(help="A TOML file of settings: see docs/training.md.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="By default reports/training/TASK-METHOD-SEED.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint.")] = False,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
) -> None:
    """Train a learner in two phases: curiosity alone, then the task."""
    # Not at the top: torch takes seconds, and --help shall not.
    from minitouch_bench.agents.config import make_config
    from minitouch_bench.workflows.train import TrainingRequest, default_directory
    from minitouch_bench.workflows.train import train as run_training

    given = {
        "method": method,
        "seed": seed,
        "objects": objects,
        "log": None if from_log is None else str(from_log),
        "exploration": None if exploration_steps is None else {"steps": exploration_steps},
        "task_phase": None if task_steps is None else {"steps": task_steps},
    }
    changes = {name: value for name, value in given.items() if value is not None}
    settings = make_config(task, preset, config, changes)
    directory = output or default_directory(settings)
    with _interrupts() as interrupts, _TrainingProgress(settings.steps) as progress:
        finished = run_training(
            TrainingRequest(
                settings,
                directory,
                resume=resume,
                device=device,
                on_row=progress.show,
                should_stop=lambda: bool(interrupts),
                note=lambda text: notes.print(text, markup=False),
            )
        )
    if not finished:
        raise InterruptedRunError(
            f"interrupted; what is learned is kept in {directory}, and the same command with "
            "--resume continues"
        )
    print(directory)


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


class _TrainingProgress(Progress):
    """Steps done, what they showed since the last row, and the time left.

    Where there is no terminal, one line per minute says so.
    """

    def __init__(self, steps: int) -> None:
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
        self._bar = self.add_task("training", total=steps, figures="")
        self._steps, self._told_at = steps, time.monotonic()

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
