"""``minitouch-bench report``: draw reports of finished runs, side by side."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli.console import data_console, notes
from minitouch_bench.workflows import options

curve_option = partial(typer.Option, rich_help_panel="Learning curve")


def report(
    runs: Annotated[list[Path], typer.Argument(help="Directories of finished runs.")],
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            help="Where to write report.md and report.html; by default the run's own directory, "
            "of a submission's run one in reports/."
        ),
    ] = None,
    names: Annotated[
        str | None,
        typer.Option(
            help="What to call the runs, separated by commas; with --curve their trainings."
        ),
    ] = None,
    curve: Annotated[
        bool, curve_option("--curve", help="Draw the runs over training steps.")
    ] = False,
    steps: Annotated[
        str | None,
        curve_option(
            metavar="N,N",
            help="Training steps of each run. Without it they are read from the files of the "
            "training, or from a policy's name such as rl_model_10000_steps.",
        ),
    ] = None,
    latex: Annotated[
        bool, typer.Option("--latex", help="Print Table 4 as LaTeX in place of the tables.")
    ] = False,
    figures: Annotated[
        Path | None, typer.Option(help="Write every figure there, as SVG and PDF.")
    ] = None,
) -> None:
    """Show finished runs in one Table-4 report, and write it as pages, LaTeX and figures."""
    from minitouch_bench.reporting.report import table4_latex
    from minitouch_bench.reporting.writers import show_report
    from minitouch_bench.workflows import report as workflow

    asked = workflow.ReportOptions(
        tuple(runs),
        output,
        None if names is None else tuple(name.strip() for name in names.split(",")),
        curve,
        () if steps is None else options.whole_numbers("--steps", steps),
        figures,
    )
    done = workflow.report(asked)
    if done.curve is not None:
        notes.print(f"curve: {done.curve}", markup=False)
    if figures is not None:
        notes.print(f"figures: {len(done.figures)} files in {figures}", markup=False)
    if latex:
        print(table4_latex(done.report), end="")
    else:
        show_report(done.report, data_console())
    notes.print(f"report: {done.directory / 'report.html'}", markup=False)
