"""Show finished runs, in one report or compared: the commands ``report`` and ``compare``."""

from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.errors import MiniTouchError, UsageError
from minitouch_bench.files import REPORTS, SUBMISSION_FILE, list_videos, read_file, write_file
from minitouch_bench.records import PolicyIdentity, Role
from minitouch_bench.workflows import options
from minitouch_bench.workflows.options import Numbers, StrPath, Words

if TYPE_CHECKING:
    from minitouch_bench.regression.comparison import Comparison
    from minitouch_bench.reporting.labels import RunOrigin
    from minitouch_bench.reporting.report import Report
    from minitouch_bench.runs.run import Run as SavedRun
    from minitouch_bench.workflows.results import Run

COMPARISON = REPORTS / "comparison"
"""Where the report of several runs is written without ``output``."""

CURVE_FILE = "learning-curve.csv"

runs_argument = partial(typer.Argument, metavar="RUN", help="Directories of finished runs.")
curve_option = partial(typer.Option, rich_help_panel="Learning curve")


@dataclass(frozen=True)
class WrittenReport:
    """A report, its directory, the figures' files, and that of the curve's numbers."""

    report: "Report"
    directory: Path
    figures: tuple[Path, ...]
    curve: Path | None


def report(
    *runs: Annotated[StrPath, runs_argument()],
    output: Annotated[StrPath | None, typer.Option()] = None,
    names: Annotated[Words | None, typer.Option()] = None,
    curve: Annotated[bool, curve_option()] = False,
    steps: Annotated[Numbers | None, curve_option(metavar="N,N")] = None,
    figures: Annotated[StrPath | None, typer.Option()] = None,
) -> WrittenReport:
    """Show finished runs in one Table-4 report, and write it as pages, LaTeX and figures.

    Args:
        output: Directory of report.md and report.html; by default the run's, for a submission's
            run one in reports/, for several runs reports/comparison.
        names: Names of the runs, separated by commas; with --curve of their trainings.
        curve: Plot the runs over training steps.
        steps: Training steps of each run; by default from the training's files, or from a
            policy's name such as rl_model_10000_steps.
        figures: Write every figure to this directory, as SVG and PDF.

    Raises:
        UsageError: the runs cannot stand in one report, or names or steps do not fit them.
        RunDirectoryError: a run cannot be read, or a file cannot be written.
    """
    from minitouch_bench.reporting.report import AcrossRuns
    from minitouch_bench.reporting.views import view_directory, write_report, write_tables
    from minitouch_bench.runs.run import read_run

    trained = options.whole_numbers("--steps", steps)
    if trained and not curve:
        raise UsageError("--steps places runs on a curve: add --curve")
    opened = [read_run(Path(run)) for run in runs]
    paths = [run.directory or Path() for run in opened]
    single = len(opened) == 1
    usual = view_directory(paths[0]) if single else COMPARISON
    directory = usual if output is None else Path(output)
    videos = list_videos(paths[0]) if single else []
    origins = tuple(find_origin(*pair) for pair in zip(paths, opened, strict=True))
    across = AcrossRuns(origins, curve, trained)
    labels = None if names is None else options.words(names)
    built = write_report(opened, directory, videos, labels, across)
    if single:
        write_tables(opened[0], directory)
    numbers = directory / CURVE_FILE if curve else None
    if numbers is not None:
        write_file(numbers, built.over_runs.curve_csv)
    files = () if figures is None else tuple(_write_figures(built, Path(figures)))
    return WrittenReport(built, directory, files, numbers)


def find_origin(path: Path, run: "SavedRun") -> "RunOrigin":
    """Return the training that a run's policy comes from, as far as files beside it say so.

    They are the ``submission.toml`` of the submission that holds the run, or the ``config.toml``
    of the training directory that holds the policy or the run.
    """
    from minitouch_bench.agents.config import CONFIG_FILE, TrainingConfig, read_config
    from minitouch_bench.leaderboard.submission import read_submission
    from minitouch_bench.reporting.labels import RunOrigin
    from minitouch_bench.verification.problems import Problems

    policy = run.header.policy
    source, directory = Path(policy.source), path.resolve()
    try:
        about = directory.parent.parent / SUBMISSION_FILE
        if about.is_file() and (submission := read_submission(read_file(about), Problems())):
            return RunOrigin(submission.name, submission.training_steps)
        if not policy.digest:  # a built-in policy
            return RunOrigin()
        for training in (source.parent, source, directory.parent):
            if (training / CONFIG_FILE).is_file():
                config = read_config(training / CONFIG_FILE, TrainingConfig(""))
                explored = source.stem == Role.EXPLORATION
                steps = config.exploration.steps if explored else config.steps
                return RunOrigin(config.method, _kept_steps(training, policy) or steps)
    except (MiniTouchError, OSError):  # another program's file of that name
        pass
    return RunOrigin()


def _kept_steps(training: Path, policy: PolicyIdentity) -> int:
    """Return the steps of a policy that was kept when its training was made longer, else 0."""
    from minitouch_bench.policies.sources import KEPT_FILE, parse_source

    first, last = KEPT_FILE.split("{}")
    for file in training.glob(KEPT_FILE.format("*")):
        steps = file.name.removeprefix(first).removesuffix(last)
        if steps.isdecimal() and parse_source(str(file)).digest == policy.digest:
            return int(steps)
    return 0


def _write_figures(built: "Report", directory: Path) -> list[Path]:
    # matplotlib takes half a second to load, and only files need it.
    from minitouch_bench.rendering.figure_files import write_figures
    from minitouch_bench.reporting.figures import report_figures, split_figures

    figures = (*built.over_runs.figures, *report_figures(built), *split_figures(built))
    return write_figures(figures, directory)


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
