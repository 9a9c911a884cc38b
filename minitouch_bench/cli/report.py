"""``minitouch-bench report``: draw reports of finished runs, side by side."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli.consoles import data_console, notes
from minitouch_bench.files import VIDEOS
from minitouch_bench.reporting import read_run, show_report, write_report


def report(
    runs: Annotated[list[Path], typer.Argument(help="Directories of finished runs.")],
    output: Annotated[
        Path | None,
        typer.Option(help="Where to write report.md and report.html; by default the run's own."),
    ] = None,
) -> None:
    """Show finished runs in one Table-4 report; several need --output to be written."""
    saved = [read_run(run) for run in runs]
    directory = output or (runs[0] if len(runs) == 1 else Path("reports/comparison"))
    videos = sorted((runs[0] / VIDEOS).glob("*.mp4")) if len(runs) == 1 else []
    show_report(write_report(saved, directory, videos), data_console())
    notes.print(f"report: {directory / 'report.html'}", markup=False)
