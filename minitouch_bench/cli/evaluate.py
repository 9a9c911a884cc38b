"""``minitouch-bench evaluate``: what it prints."""

from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.cli.console import data_console, notes
from minitouch_bench.workflows import options

if TYPE_CHECKING:
    from minitouch_bench.workflows.results import Run

FINISHED_WITH_FAULTS = 4


def show_evaluation(
    run: "Run",
    *,
    config: options.Config = None,  # noqa: ARG001  its callback reads it before the others
    as_json: Annotated[
        bool, options.output_option("--json", help="Print run.json in place of the tables.")
    ] = False,
) -> None:
    """Print Table 4 and where the report is; a run with policy faults has its own exit code."""
    from minitouch_bench.reporting.report import build_report
    from minitouch_bench.reporting.writers import show_report
    from minitouch_bench.runs.run import run_json

    if as_json:
        print(run_json(run.facts).decode(), end="")
    else:
        show_report(build_report([run.facts]), data_console())
    assert run.directory is not None
    notes.print(f"report: {run.directory / 'report.html'}", markup=False)
    if run.faults:
        raise typer.Exit(FINISHED_WITH_FAULTS)
