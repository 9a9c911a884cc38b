"""Show finished runs, in one report or compared: the commands ``report`` and ``compare``."""

from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.errors import UsageError
from minitouch_bench.files import REPORTS, list_videos, write_file
from minitouch_bench.workflows import options
from minitouch_bench.workflows.options import StrPath, Words

if TYPE_CHECKING:
    from minitouch_bench.regression.comparison import Comparison
    from minitouch_bench.reporting.report import Report
    from minitouch_bench.workflows.results import Run

COMPARISON = REPORTS / "comparison"
"""Where the report of several runs is written without ``output``."""

runs_argument = partial(typer.Argument, metavar="RUN", help="Directories of finished runs.")


@dataclass(frozen=True)
class ShownReport:
    """A report; the directory of its page, None where there is none; Table 4 as text, "" for none.

    A report has one of both.
    """

    report: "Report"
    directory: Path | None = None
    text: str = ""


def report(
    *runs: Annotated[StrPath, runs_argument()],
    output: Annotated[StrPath | None, typer.Option(metavar="DIR")] = None,
    names: Annotated[Words | None, typer.Option(metavar="A,B")] = None,
    tasks: Annotated[Words | None, typer.Option(metavar="A,B")] = None,
    metrics: Annotated[Words | None, typer.Option(metavar="A,B")] = None,
    table_format: Annotated[
        str | None, typer.Option("--format", metavar="md|latex|csv|json")
    ] = None,
) -> ShownReport:
    """Show finished runs beside each other in Table 4, and write report.html.

    Args:
        output: Directory of report.html; by default the run's, for a submission's run one in
            reports/, for several runs reports/comparison.
        names: Names of the runs.
        tasks: Only these tasks.
        metrics: The rows of Table 4: see docs/reference/metrics.md.
        table_format: Print Table 4 in this format, and write no page.

    Raises:
        UsageError: the runs cannot stand in one report, a name does not fit them, or output and
            format are both given.
        RunDirectoryError: a run cannot be read, or the page cannot be written.
    """
    from minitouch_bench.reporting.report import Shown, build_report, view_directory
    from minitouch_bench.reporting.writers import TABLE_FORMATS, write_page
    from minitouch_bench.runs.run import read_run

    if table_format is not None and table_format not in TABLE_FORMATS:
        raise UsageError(f"no format '{table_format}'; there are {', '.join(TABLE_FORMATS)}")
    if table_format is not None and output is not None:
        raise UsageError("--format prints Table 4 and writes no page: leave --output out")
    opened = [read_run(Path(run)) for run in runs]
    named = None if names is None else options.words(names)
    shown = Shown(named, options.words(tasks), options.words(metrics))
    if table_format is not None:
        built = build_report(opened, shown=shown)
        return ShownReport(built, text=TABLE_FORMATS[table_format](built))
    paths = [run.directory or Path() for run in opened]
    single = len(opened) == 1
    usual = view_directory(paths[0]) if single else COMPARISON
    directory = usual if output is None else Path(output)
    videos = list_videos(paths[0]) if single else []
    return ShownReport(write_page(opened, directory, videos, shown), directory)


def compare(
    *runs: Annotated["Run | StrPath", runs_argument()],
    output: Annotated[StrPath | None, typer.Option()] = None,
) -> "Comparison":
    """Compare runs episode by episode: differences, intervals, verdicts, changed outcomes.

    Each run is compared with the first one. In Python a run can also be a ``Run``.

    Args:
        output: Write comparison.md and comparison.json to this directory.

    Raises:
        UsageError: the runs have other episodes or another protocol.
        RunDirectoryError: a directory is not a run, or is damaged.
    """
    from minitouch_bench.regression.comparison import compare_runs
    from minitouch_bench.regression.writers import comparison_json, comparison_markdown
    from minitouch_bench.runs.run import read_run

    opened = [read_run(Path(run)) if isinstance(run, str | PathLike) else run.facts for run in runs]
    comparison = compare_runs(opened, [str(run.directory or run.name) for run in opened])
    if output is not None:
        write_file(Path(output) / "comparison.json", comparison_json(comparison))
        write_file(Path(output) / "comparison.md", comparison_markdown(comparison))
    return comparison
