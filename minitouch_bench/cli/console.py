"""Where the command line prints: data on stdout, progress and notes on stderr."""

import time
from collections.abc import Callable
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import EpisodeRecord, Outcome, Role
from minitouch_bench.workflows import Callbacks

PIPED_WIDTH = 120
"""Columns of a table that goes into a file or another program."""

LINE_INTERVAL_S = 60.0
"""Seconds between two lines of progress where no terminal shows a bar."""

notes = Console(stderr=True, soft_wrap=True, highlight=False)


def data_console() -> Console:
    """Return the console of stdout, as wide as the screen, or as a page where there is none."""
    console = Console()
    return console if console.is_terminal else Console(width=PIPED_WIDTH)


class EpisodeProgress:
    """Episodes done, success so far, and the time left; shown from the first phase on.

    Where there is no terminal, one line per minute says so.
    """

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic) -> None:
        self._console = console
        self._clock = clock
        self._told_at = clock()
        self._tally: dict[str, list[bool]] = {}
        self._faults = 0
        self._bar: TaskID | None = None
        self._progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TextColumn("{task.fields[success]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            refresh_per_second=2,
        )

    @property
    def callbacks(self) -> Callbacks:
        """What a workflow calls to have its episodes shown."""
        return Callbacks(self._note, self._begin_phase, self._add)

    def __enter__(self) -> "EpisodeProgress":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._progress.stop()

    def _note(self, line: str) -> None:
        self._console.print(line, markup=False)

    def _begin_phase(self, name: str, episodes: int) -> None:
        if self._bar is None:
            self._progress.start()
        self._tally, self._faults = {}, 0
        self._bar = self._progress.add_task(name, total=episodes, success="")

    def _add(self, record: EpisodeRecord) -> None:
        assert self._bar is not None
        self._faults += record.outcome is Outcome.POLICY_FAULT
        if record.spec.task in GOAL_TASKS and record.spec.role is Role.FINAL:
            success = record.outcome is Outcome.SUCCESS
            self._tally.setdefault(record.spec.task, []).append(success)
        parts = [f"{task} {sum(won)}/{len(won)}" for task, won in self._tally.items()]
        if self._faults:
            parts.append(f"[red]{self._faults} faults[/red]")
        self._progress.update(self._bar, advance=1, success="  ".join(parts))
        if not self._console.is_terminal and self._clock() >= self._told_at + LINE_INTERVAL_S:
            self._told_at = self._clock()
            bar = self._progress.tasks[self._bar]
            line = "  ".join([f"{bar.description}: {bar.completed:.0f} of {bar.total:.0f}", *parts])
            self._console.print(line)
