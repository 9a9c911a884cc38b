"""Report finished runs, alone or side by side: pages, figures, and a curve over checkpoints."""

from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.agents.config import CONFIG_FILE, TrainingConfig, read_config
from minitouch_bench.errors import MiniTouchError, UsageError
from minitouch_bench.files import REPORTS, list_videos, write_file
from minitouch_bench.leaderboard.packing import begun_submission
from minitouch_bench.records import Role
from minitouch_bench.reporting.labels import RunOrigin
from minitouch_bench.reporting.report import AcrossRuns, Report
from minitouch_bench.reporting.views import view_directory, write_report, write_tables
from minitouch_bench.runs.run import Run, read_run

COMPARISON = REPORTS / "comparison"
"""Where the report of several runs is written without ``output``."""

CURVE_FILE = "learning-curve.csv"


@dataclass(frozen=True)
class ReportOptions:
    """Which runs, what to call them, and where to write.

    ``curve``: draw them as checkpoints of trainings, which ``names`` then names, after ``steps``
    training steps. ``figures``: where every figure is written as SVG and PDF.
    """

    runs: tuple[Path, ...]
    output: Path | None = None
    names: tuple[str, ...] | None = None
    curve: bool = False
    steps: tuple[int, ...] = ()
    figures: Path | None = None


@dataclass(frozen=True)
class WrittenReport:
    """A report, its directory, the figures' files, and that of the curve's numbers."""

    report: Report
    directory: Path
    figures: tuple[Path, ...] = ()
    curve: Path | None = None


def report(options: ReportOptions) -> WrittenReport:
    """Write ``report.md`` and ``report.html`` of the runs, and what else is asked for.

    Raises:
        UsageError: the runs cannot stand in one report, or names or steps do not fit them.
        RunDirectoryError: a run cannot be read, or a file cannot be written.
    """
    if options.steps and not options.curve:
        raise UsageError("--steps says where runs stand on a curve: add --curve")
    runs = [read_run(path) for path in options.runs]
    single = len(runs) == 1
    directory = options.output or (view_directory(options.runs[0]) if single else COMPARISON)
    videos = list_videos(options.runs[0]) if single else []
    origins = tuple(find_origin(*pair) for pair in zip(options.runs, runs, strict=True))
    across = AcrossRuns(origins, options.curve, options.steps)
    built = write_report(runs, directory, videos, options.names, across)
    if single:
        write_tables(runs[0], directory)
    curve = directory / CURVE_FILE if options.curve else None
    if curve is not None:
        write_file(curve, built.over_runs.curve_csv)
    figures = [] if options.figures is None else _write_figures(built, options.figures)
    return WrittenReport(built, directory, tuple(figures), curve)


def find_origin(path: Path, run: Run) -> RunOrigin:
    """Return the training that a run's policy comes from, as far as files beside it say so.

    They are the ``submission.toml`` of the submission that holds the run, or the ``config.toml``
    of the training directory that holds the policy or the run.
    """
    source = Path(run.header.policy.source)
    directory = path.resolve()
    try:
        if submission := begun_submission(directory.parent.parent):
            return RunOrigin(submission.name, submission.training_steps)
        for training in (source.parent, source, directory.parent):
            if (training / CONFIG_FILE).is_file():
                config = read_config(training / CONFIG_FILE, TrainingConfig(""))
                explored = source.stem == Role.EXPLORATION
                return RunOrigin(
                    config.method, config.exploration.steps if explored else config.steps
                )
    except (MiniTouchError, OSError):  # another program's file of that name
        pass
    return RunOrigin()


def _write_figures(built: Report, directory: Path) -> list[Path]:
    # matplotlib takes half a second to load, and only files need it.
    from minitouch_bench.rendering.figure_files import write_figures
    from minitouch_bench.reporting.figures import report_figures, split_figures

    figures = (*built.over_runs.figures, *report_figures(built), *split_figures(built))
    return write_figures(figures, directory)
