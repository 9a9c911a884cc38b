"""``minitouch-bench report``: draw reports of finished runs, side by side."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli.console import data_console, notes
from minitouch_bench.files import list_videos


def report(
    runs: Annotated[list[Path], typer.Argument(help="Directories of finished runs.")],
    output: Annotated[
        Path | None,
        typer.Option(help="Where to write report.md and report.html; by default the run's own."),
    ] = None,
    names: Annotated[
        str | None, typer.Option(help="What to call the runs, separated by commas.")
    ] = None,
    latex: Annotated[
        bool, typer.Option("--latex", help="Print Table 4 as LaTeX in place of the tables.")
    ] = False,
    figures: Annotated[
        Path | None, typer.Option(help="Write every figure there, as SVG and PDF.")
    ] = None,
) -> None:
    """Show finished runs in one Table-4 report, and write it as pages, LaTeX and figures."""
    from minitouch_bench.reporting import read_run, show_report, table4_latex, write_report

    saved = [read_run(run) for run in runs]
    directory = output or (runs[0] if len(runs) == 1 else Path("reports/comparison"))
    videos = list_videos(runs[0]) if len(runs) == 1 else []
    told = None if names is None else [name.strip() for name in names.split(",")]
    built = write_report(saved, directory, videos, told)
    if figures is not None:
        # matplotlib takes half a second to load, and only files need it.
        from minitouch_bench.rendering.figure_files import write_figures
        from minitouch_bench.reporting.figures import report_figures, split_figures

        files = write_figures((*report_figures(built), *split_figures(built)), figures)
        notes.print(f"figures: {len(files)} files in {figures}", markup=False)
    if latex:
        print(table4_latex(built), end="")
    else:
        show_report(built, data_console())
    notes.print(f"report: {directory / 'report.html'}", markup=False)
