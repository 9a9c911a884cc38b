"""``minitouch-bench study``: a grid of trainings from a TOML file, evaluated and compared."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import notes
from minitouch_bench.errors import InfrastructureError


def study(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The grid: see docs/training.md.")],
    output: Annotated[
        Path | None, typer.Option(help="By default reports/studies/NAME, after the file.")
    ] = None,
    workers: options.Workers = "1",
    engine: options.StudyEngine = "local",
    address: options.Address = None,
) -> None:
    """Train and evaluate a grid of methods, tasks and seeds; started again, it goes on.

    Exit 5 where a training failed: the same command tries it again.
    """
    from minitouch_bench.evaluation.engine import EngineOptions
    from minitouch_bench.reporting.study import StudyResults, state_lines
    from minitouch_bench.workflows.study import STUDIES, StudyOptions, read_study, run_study

    def show(found: StudyResults) -> None:
        notes.print(state_lines(found)[0], markup=False)

    directory = output or STUDIES / file.stem
    runs_it = EngineOptions(engine, options.worker_count(workers), address)
    found = run_study(StudyOptions(read_study(file), directory, runs_it, show))
    if found.failed:
        raise InfrastructureError("\n".join(state_lines(found)[1:]))
    print(directory / "report.html")
