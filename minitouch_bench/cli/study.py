"""``minitouch-bench study``: a grid of trainings from a TOML file, evaluated and compared."""

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from minitouch_bench.cli.console import LINE_INTERVAL_S, notes
from minitouch_bench.errors import InfrastructureError, RunDirectoryError
from minitouch_bench.workflows import options

if TYPE_CHECKING:
    from minitouch_bench.reporting.study import StudyTraining
    from minitouch_bench.workflows.study import StudyConfig

REFRESH_S = 10.0
"""A training writes a row about as often; each look reads all trainings' rows."""
SHOWN = 3
"""Trainings under way that are named; the others are counted."""


def study(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="The grid: see docs/how-to/studies.md.")
    ],
    output: Annotated[
        Path | None, typer.Option(help="By default reports/studies/NAME, after the file.")
    ] = None,
    workers: options.WorkersText = "1",
    engine: options.StudyEngine = "local",
    address: options.Address = None,
) -> None:
    """Train and evaluate a grid of methods, tasks and seeds; started again, it goes on.

    Exit 5 where a training failed: the same command tries it again.
    """
    from minitouch_bench.reporting.study import StudyResults, state_lines
    from minitouch_bench.workflows.study import STUDIES, StudyOptions, read_study, run_study

    def show(found: StudyResults) -> None:
        notes.print(state_lines(found)[0], markup=False)

    directory = output or STUDIES / file.stem
    runs_it = options.engine_options(engine, workers, address)
    config = read_study(file)
    with _shown_progress(config, directory):
        found = run_study(StudyOptions(config, directory, runs_it, show))
    if found.failed:
        raise InfrastructureError("\n".join(state_lines(found)[1:]))
    print(directory / "report.html")


@contextmanager
def _shown_progress(config: "StudyConfig", directory: Path) -> Iterator[None]:
    """Show the control steps of all trainings, and those under way, as their files tell them.

    Where there is no terminal, one line per minute says so.
    """
    totals = {training: config.config_of(training).steps for training in config.trainings()}
    progress = Progress(
        TextColumn("[bold]control steps"),
        BarColumn(bar_width=20),
        TextColumn("{task.completed:,.0f}/{task.total:,.0f}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[under_way]}", markup=False),
        console=notes,
        refresh_per_second=1,
        speed_estimate_period=600,
    )
    steps, under_way = _steps_done(totals, directory)
    bar = progress.add_task(
        "study", total=sum(totals.values()), completed=steps, under_way=under_way
    )
    ended = threading.Event()

    def watch() -> None:
        waited = 0.0
        while not ended.wait(REFRESH_S):
            with suppress(RunDirectoryError):  # it is told where the study reads the file
                steps, under_way = _steps_done(totals, directory)
                progress.update(bar, completed=steps, under_way=under_way)
            waited += REFRESH_S
            if not notes.is_terminal and waited >= LINE_INTERVAL_S:
                waited = 0.0
                task = progress.tasks[bar]
                line = f"{task.completed:,.0f} of {task.total:,.0f} control steps"
                notes.print(f"{line}  {task.fields['under_way']}", markup=False)

    watcher = threading.Thread(target=watch, daemon=True)
    with progress:
        watcher.start()
        try:
            yield
        finally:
            ended.set()
            watcher.join()
            with suppress(RunDirectoryError):
                progress.update(bar, completed=_steps_done(totals, directory)[0], under_way="")


def _steps_done(totals: "Mapping[StudyTraining, int]", directory: Path) -> tuple[int, str]:
    """Return the control steps of all trainings so far, and in words those that are under way."""
    from minitouch_bench.reporting.study import last_progress

    done = {training: last_progress(directory, training)[0] for training in totals}
    named = [
        f"{training.name} {steps:,}/{totals[training]:,}"
        for training, steps in done.items()
        if 0 < steps < totals[training]
    ]
    more = [f"{len(named) - SHOWN} more"] if len(named) > SHOWN else []
    return sum(done.values()), "  ".join([*named[:SHOWN], *more])
