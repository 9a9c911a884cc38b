"""The views of a run that people look at, written beside it and never read back."""

import os
from collections.abc import Sequence
from pathlib import Path

from minitouch_bench import files
from minitouch_bench.reporting.frames import episodes_csv, generalization_csv, table4_csv
from minitouch_bench.reporting.report import ALONE, AcrossRuns, Report, build_report, find_videos
from minitouch_bench.reporting.writers import to_html, to_markdown
from minitouch_bench.runs.run import Run


def write_tables(run: Run, directory: Path) -> None:
    """Write the CSV files of a run.

    Raises:
        RunDirectoryError: one cannot be written.
    """
    files.write_file(directory / files.EPISODES_FILE, episodes_csv(run.episodes))
    files.write_file(directory / files.TABLE4_FILE, table4_csv(run))
    if run.exploration_episodes:
        files.write_file(directory / files.EXPLORATION_FILE, episodes_csv(run.exploration_episodes))
    if run.summary.generalization:
        files.write_file(directory / files.GENERALIZATION_FILE, generalization_csv(run))


def write_report(
    runs: Sequence[Run],
    directory: Path,
    videos: Sequence[Path] = (),
    names: Sequence[str] | None = None,
    across: AcrossRuns = ALONE,
) -> Report:
    """Write ``report.md`` and ``report.html`` of one or several runs; return what they show.

    Raises:
        UsageError: runs of different protocols, or names that do not fit them.
        RunDirectoryError: a file cannot be written.
    """
    report = build_report(runs, find_videos(videos, directory), names, across)
    files.write_file(directory / files.REPORT_FILE, to_markdown(report))
    files.write_file(directory / files.REPORT_PAGE, to_html(report))
    return report


def view_directory(run: Path) -> Path:
    """Return where reports and videos of a finished run are written: its own directory.

    Submissions stay as they are: the views of their runs are written to ``reports/NAME/...``, in
    the working directory, or beside the submissions where that is one of them.
    """
    submission = run.resolve().parent.parent
    if not os.path.lexists(submission / files.SUBMISSION_FILE):
        return run
    reports, place, beside = files.REPORTS, Path.cwd(), submission.parent
    is_collection = beside.name == files.SUBMISSIONS.name
    if place.is_relative_to(submission) or (is_collection and place == beside):
        reports = (beside.parent if is_collection else beside) / files.REPORTS
    return reports / run.resolve().relative_to(beside)
