"""What the command line prints: data on stdout, notes and progress on stderr.

Progress is bars in a terminal, one bar in a notebook, and otherwise one line per minute.
"""

import html
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import cache
from typing import TYPE_CHECKING, Any

from minitouch_bench.episode import Outcome, PlayedEpisode, Role
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.text import printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Task

PIPED_WIDTH = 10_000
"""Columns where no screen ends a line: a table is as wide as what it holds."""

LINE_INTERVAL_S = 60.0
"""Seconds between two lines of progress where no terminal shows a bar."""


@cache
def notes() -> "Console":
    """Return the console of stderr; FORCE_COLOR makes no bars in a file."""
    from rich.console import Console

    is_screen = None if sys.stderr.isatty() else False
    return Console(
        stderr=True, soft_wrap=True, highlight=False, emoji=False, force_terminal=is_screen
    )


def note(text: str, style: str = "") -> None:
    """Print lines on stderr; they may quote a stranger's name."""
    lines = "\n".join(map(printable, text.splitlines()))
    notes().print(lines, markup=False, style=style)


def data_console() -> "Console":
    """Return the console of stdout, as wide as the screen; a pipe or a file cuts no line."""
    from rich.console import Console

    # Not ``Console.is_terminal``, which FORCE_COLOR sets for a pipe too.
    return Console(width=None if sys.stdout.isatty() else PIPED_WIDTH, emoji=False)


def print_problems(name: str, problems: Iterable[object]) -> None:
    """Print a line for each problem of a submission."""
    for problem in problems:
        print(f"{printable(name)}: {printable(str(problem))}")


def is_watched() -> bool:
    """Tell whether a terminal or a notebook shows progress."""
    return notes().is_terminal or notes().is_jupyter


class _Progress:
    """Bars in a terminal, one bar per phase in a notebook, otherwise one line per minute."""

    def __init__(self, console: "Console") -> None:
        from rich import progress
        from rich.table import Column
        from rich.text import Text

        class Bars(progress.Progress):
            def get_renderables(self) -> Iterator[Any]:
                yield self.make_tasks_table(self.tasks)
                if self.tasks and self.tasks[-1].fields["text"]:
                    yield Text(self.tasks[-1].fields["text"])

        whole = Column(no_wrap=True)
        self._bars = Bars(
            progress.TextColumn("[bold]{task.description}"),
            progress.BarColumn(bar_width=20),
            progress.TextColumn("{task.completed:,.0f}/{task.total:,.0f}", table_column=whole),
            progress.TimeElapsedColumn(table_column=whole),
            progress.TextColumn("left"),
            progress.TimeRemainingColumn(table_column=whole),
            console=console,
            disable=console.is_jupyter,
            refresh_per_second=2,
            speed_estimate_period=600,
        )
        self._console, self._printed_at = console, time.monotonic()
        self._cells: dict[str, Any] = {}  # of a notebook, by what is done in it

    def begin(self, name: str, total: int) -> None:
        """Begin a phase."""
        self._bars.start()
        self._bars.add_task(name, total=total, text="")

    def show(self, text: str = "", done: int | None = None, name: str = "", unit: str = "") -> None:
        """Show how far the phase is: one more is done, or ``done``; it may get another name."""
        (*_, bar) = self._bars.tasks
        done = int(bar.completed) + 1 if done is None else done
        name = name or bar.description
        self._bars.update(bar.id, completed=done, text=text, description=name)
        line = f"{name}: {done:,} of {bar.total:,}{unit}  {text}".rstrip()
        if self._console.is_jupyter:
            self._show_in_notebook(line, bar)
        elif (
            not self._console.is_terminal and time.monotonic() >= self._printed_at + LINE_INTERVAL_S
        ):
            self._printed_at = time.monotonic()
            self._console.print(line, markup=False)

    def _show_in_notebook(self, line: str, bar: "Task") -> None:
        from IPython.display import display

        left = bar.time_remaining
        line += "" if bar.finished or left is None else f"  {timedelta(seconds=round(left))} left"
        drawn = f"<progress value='{bar.completed:.0f}' max='{bar.total:.0f}'></progress>"
        shown = {"text/plain": line, "text/html": f"{drawn} {html.escape(line)}"}
        if cell := self._cells.get(bar.description):
            cell.update(shown, raw=True)
        else:
            cell = display(shown, raw=True, display_id=True)  # type: ignore[no-untyped-call]
            self._cells[bar.description] = cell

    def end(self) -> None:
        """Leave the bars as they are."""
        if self._bars.tasks:
            self._bars.stop()


@contextmanager
def episode_progress() -> Iterator[Callbacks]:
    """Show episodes done, success so far, and the time left, from the first phase on.

    Yields the functions that an evaluation calls to have its episodes shown.
    """
    progress = _Progress(notes())
    tally: dict[str, list[bool]] = {}
    faults = 0

    def begin(name: str, episodes: int) -> None:
        nonlocal faults
        tally.clear()
        faults = 0
        progress.begin(name, episodes)

    def show(record: PlayedEpisode) -> None:
        nonlocal faults
        faults += record.outcome is Outcome.POLICY_FAULT
        if record.spec.task in GOAL_TASKS and record.spec.role is Role.FINAL:
            success = record.outcome is Outcome.SUCCESS
            tally.setdefault(record.spec.task, []).append(success)
        shown = [f"{task} {sum(won)}/{len(won)}" for task, won in tally.items()]
        progress.show("  ".join([*shown, f"policy faults {faults}"] if faults else shown))

    try:
        yield Callbacks(note, begin, show)
    finally:
        progress.end()


@contextmanager
def count_progress(label: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function that takes (done, total); its first call shows a bar."""
    progress = _Progress(notes())
    begin = cache(progress.begin)  # once

    def show(done: int, total: int) -> None:
        begin(label, total)
        progress.show(done=done)

    try:
        yield show
    finally:
        progress.end()


@contextmanager
def training_progress() -> Iterator[Callbacks]:
    """Show a training on the screen, and end it between two steps after a Ctrl-C or SIGTERM.

    A second one ends it at once. Yields the functions that a training calls to be shown.
    """
    progress = _Progress(notes())
    should_stop = False

    def interrupt(*_: object) -> None:
        nonlocal should_stop
        if should_stop:
            raise KeyboardInterrupt
        should_stop = True

    def show(row: Any) -> None:
        measured = {
            "curiosity": row.intrinsic_reward,
            "reward": row.task_reward,
            "touch": row.touch_share,
            "success": row.success,
        }
        values = (f"{name} {value:.2f}" for name, value in measured.items() if value is not None)
        progress.show("  ".join(values), row.step, row.phase, " control steps")

    is_main = threading.current_thread() is threading.main_thread()  # another handles no signal
    stops = (signal.SIGINT, signal.SIGTERM) if is_main else ()
    before = {number: signal.signal(number, interrupt) for number in stops}
    try:
        yield Callbacks(note, progress.begin, row=show, should_stop=lambda: should_stop)
    finally:
        progress.end()
        for number, handler in before.items():
            signal.signal(number, handler)
