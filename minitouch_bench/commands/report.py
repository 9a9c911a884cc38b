"""The command ``report``: finished runs beside each other in Table 4."""

import hashlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from minitouch_bench.commands import options
from minitouch_bench.commands.options import flag, option
from minitouch_bench.console import data_console, note
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.files import REPORTS, holds_run, list_videos
from minitouch_bench.json_io import words

if TYPE_CHECKING:
    from minitouch_bench.runs.run import Run

COMPARISONS = REPORTS / "comparison"
"""Where the reports of several runs are written without ``--output``, each in a folder."""


def report(
    runs: options.RunsArgument,
    *,
    output: Annotated[
        Path | None,
        option("DIR", "By default the run's; for several, or a submission's, one in reports/."),
    ] = None,
    names: Annotated[str | None, option("A,B", "Names of the runs.")] = None,
    tasks: Annotated[str | None, option("A,B", "Only these tasks.")] = None,
    metrics: Annotated[
        str | None, option("A,B", "The rows of Table 4: see docs/reference/metrics.md.")
    ] = None,
    diagnostics: Annotated[
        bool,
        flag("--diagnostics", "Also print what explains Table 4: contact, force, time, endings."),
    ] = False,
    table_format: Annotated[
        Literal["md", "latex", "csv", "json"] | None,
        option("md|latex|csv|json", "Print Table 4 in this format, and write no page.", "--format"),
    ] = None,
    figure: Annotated[
        Path | None,
        option("FILE", "Also draw the runs' intervals, grouped by task: .svg, .pdf or .png."),
    ] = None,
    no_paper: Annotated[bool, flag("--no-paper", "Leave out the paper's values.")] = False,
) -> None:
    """Show finished runs beside each other in Table 4, and write report.html."""
    from minitouch_bench.reporting import figures
    from minitouch_bench.reporting import report as reporting
    from minitouch_bench.runs.run import read_run

    if table_format is not None and output is not None:
        raise UsageError("--format prints Table 4 and writes no page: leave --output out")
    if table_format is not None and diagnostics:
        raise UsageError("--format prints Table 4 alone: leave --diagnostics out")
    if figure is not None:
        figures.check_figure(figure)
    opened = [read_run(run) for run in runs]
    first, is_single = opened[0].directory or Path(), len(opened) == 1
    is_whole = is_single and not (tasks or metrics or names)  # a part never replaces the run's page
    usual = reporting.view_directory(first) if is_whole else COMPARISONS / _name_of(opened)
    directory = output or usual
    is_own = is_whole and os.path.realpath(directory) == os.path.realpath(first)
    if holds_run(directory) and not is_own:
        raise RunDirectoryError(
            f"{directory} contains a run, whose report.html this would replace: choose another "
            "--output"
        )
    shown = reporting.build_report(
        opened,
        reporting.find_videos(list_videos(first) if is_single else (), directory),
        names=None if names is None else words(names),
        tasks=words(tasks),
        metrics=words(metrics),
        directory=directory,
        with_paper=not no_paper,
    )
    if figure is not None:
        chosen = shown.metrics if metrics else ()
        figures.write_figure(shown.sections, shown.tasks, chosen, figure)
        note(f"figure: {figure}")
    if table_format is not None:
        print(reporting.TABLE_FORMATS[table_format](shown), end="")
        return
    reporting.write_page(shown, directory)
    reporting.show_report(shown, data_console(), diagnostics=diagnostics)
    note(f"report: {directory / 'report.html'}")


def _name_of(runs: "list[Run]") -> str:
    """Name the report of several runs by what they are, and by a digest that no others have."""
    from minitouch_bench.evaluation.execution import run_name

    places = "\n".join(str((run.directory or Path()).resolve()) for run in runs)
    names = "-".join(dict.fromkeys(run_name(run.header) for run in runs))
    return f"{names[:60]}-{hashlib.sha256(places.encode()).hexdigest()[:8]}"
