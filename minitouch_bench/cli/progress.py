"""The progress display of an evaluation, on stderr."""

from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import EpisodeRecord, Outcome, Role


class EvaluationProgress:
    """Episodes done, success so far, and the time left."""

    def __init__(self, total: int, console: Console) -> None:
        self._tally: dict[str, list[bool]] = {}
        self._faults = 0
        self._progress = Progress(
            TextColumn("[bold]episodes"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TextColumn("{task.fields[success]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            refresh_per_second=2,
        )
        self._bar = self._progress.add_task("episodes", total=total, success="")

    def __enter__(self) -> "EvaluationProgress":
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def add(self, record: EpisodeRecord) -> None:
        """Count one episode."""
        self._faults += record.outcome is Outcome.POLICY_FAULT
        if record.spec.task in GOAL_TASKS and record.spec.role is Role.FINAL:
            success = record.outcome is Outcome.SUCCESS
            self._tally.setdefault(record.spec.task, []).append(success)
        parts = [f"{task} {sum(won)}/{len(won)}" for task, won in self._tally.items()]
        if self._faults:
            parts.append(f"[red]{self._faults} faults[/red]")
        self._progress.update(self._bar, advance=1, success="  ".join(parts))
