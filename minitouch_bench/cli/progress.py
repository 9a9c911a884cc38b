"""Bars on stderr while a command runs; where there is no terminal, one line per minute."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column

from minitouch_bench.cli.console import note, notes
from minitouch_bench.episode import Outcome, PlayedEpisode, Role
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.protocol.minitouch import GOAL_TASKS

if TYPE_CHECKING:
    from minitouch_bench.agents.training import ProgressRow
    from minitouch_bench.agents.training_directory import TrainingProgress

LINE_INTERVAL_S = 60.0
"""Seconds between two lines of progress where no terminal shows a bar."""

WIDE = 110
"""Columns of a terminal from which a bar is a long one."""


def _make_bars(console: Console = notes) -> Progress:
    """Return the bars of every command; a task's field ``text`` stands behind its times."""
    return Progress(
        TextColumn("[bold]{task.description}"),
        BarColumn(bar_width=30 if console.width >= WIDE else 10),
        TextColumn("{task.completed:,.0f}/{task.total:,.0f}", table_column=Column(no_wrap=True)),
        TimeElapsedColumn(table_column=Column(no_wrap=True)),
        TextColumn("left"),
        TimeRemainingColumn(table_column=Column(no_wrap=True)),
        # Where there is little room only this one is broken into lines.
        TextColumn("{task.fields[text]}", markup=False, table_column=Column()),
        console=console,
        refresh_per_second=2,
        speed_estimate_period=600,
    )


class _Lines:
    """One line per minute, where a console is not a terminal."""

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic) -> None:
        self._console, self._clock, self._printed_at = console, clock, clock()

    def show(self, line: str) -> None:
        """Print a line, unless the last one is less than a minute old."""
        now = self._clock()
        if not self._console.is_terminal and now >= self._printed_at + LINE_INTERVAL_S:
            self._printed_at = now
            self._console.print(line, markup=False)


class EpisodeProgress:
    """Episodes done, success so far, and the time left; shown from the first phase on.

    Entering it gives the functions that an evaluation calls to have its episodes shown.
    """

    def __init__(
        self, console: Console = notes, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._lines = _Lines(console, clock)
        self._tally: dict[str, list[bool]] = {}
        self._faults = 0
        self._bar: TaskID | None = None
        self._progress = _make_bars(console)

    def __enter__(self) -> Callbacks:
        return Callbacks(note, self._begin_phase, self._add)

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Leave the bars as they are, so that other lines can be printed; a phase restarts them."""
        if self._bar is not None:
            self._progress.stop()
            for task in self._progress.task_ids:
                self._progress.remove_task(task)
            self._bar = None

    def _begin_phase(self, name: str, episodes: int) -> None:
        if self._bar is None:
            self._progress.start()
        self._tally, self._faults = {}, 0
        self._bar = self._progress.add_task(name, total=episodes, text="")

    def _add(self, record: PlayedEpisode) -> None:
        assert self._bar is not None
        self._faults += record.outcome is Outcome.POLICY_FAULT
        if record.spec.task in GOAL_TASKS and record.spec.role is Role.FINAL:
            success = record.outcome is Outcome.SUCCESS
            self._tally.setdefault(record.spec.task, []).append(success)
        tally = "  ".join(f"{task} {sum(won)}/{len(won)}" for task, won in self._tally.items())
        text = "  ".join(filter(None, (tally, f"{self._faults} faults" if self._faults else "")))
        self._progress.update(self._bar, advance=1, text=text)
        bar = self._progress.tasks[-1]
        self._lines.show(
            f"{bar.description}: {bar.completed:.0f} of {bar.total:.0f}  {text}".rstrip()
        )


@contextmanager
def count_progress(label: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function that takes (done, total); its first call shows a bar."""
    with ExitStack() as stack:
        bar = _make_bars()

        def show(done: int, total: int) -> None:
            if not bar.tasks:
                stack.enter_context(bar)
                bar.add_task(label, text="")
            bar.update(bar.tasks[0].id, completed=done, total=total)

        yield show


@contextmanager
def training_progress() -> Iterator["TrainingProgress"]:
    """Show a training on the screen, and end it between two steps after a Ctrl-C."""
    from minitouch_bench.agents.training_directory import TrainingProgress

    lines, bar = _Lines(notes), _make_bars()
    with _interrupts() as interrupts, bar:

        def begin(steps: int) -> None:
            bar.add_task("training", total=steps, text="")

        def show(row: "ProgressRow") -> None:
            measured = {
                "curiosity": row.intrinsic_reward,
                "reward": row.task_reward,
                "touch": row.touch_share,
                "success": row.success,
            }
            figures = "  ".join(
                f"{name} {value:.2f}" for name, value in measured.items() if value is not None
            )
            (task,) = bar.tasks
            bar.update(task.id, completed=row.step, description=row.phase, text=figures)
            lines.show(f"{row.phase}: {row.step:,} of {task.total:,} control steps  {figures}")

        yield TrainingProgress(note, begin, show, should_stop=lambda: bool(interrupts))


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Collect Ctrl-C, so that a training ends between two steps; a second one ends it at once."""
    seen: list[int] = []

    def count(number: int, _: object) -> None:
        if seen:
            raise KeyboardInterrupt
        seen.append(number)

    before = signal.signal(signal.SIGINT, count)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, before)
