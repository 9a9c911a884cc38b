"""The files of a run's directory that are derived from its records, and reading them back."""

from collections.abc import Sequence
from pathlib import Path

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import (
    EPISODES_FILE,
    EXPLORATION_FILE,
    GENERALIZATION_FILE,
    REPORT_FILE,
    REPORT_PAGE,
    RUN_FILE,
    TABLE4_FILE,
    VIDEOS,
    read_file,
    write_file,
)
from minitouch_bench.records import EvaluationRun, SavedRun, Summary
from minitouch_bench.reporting.frames import (
    csv_text,
    episodes_csv,
    generalization_frame,
    table4_frame,
)
from minitouch_bench.reporting.markdown import to_markdown
from minitouch_bench.reporting.page import to_html
from minitouch_bench.reporting.report import Report, build_report, find_videos
from minitouch_bench.reporting.run_document import parse_run, run_json, save


def write_run(run: EvaluationRun, summary: Summary, directory: Path) -> SavedRun:
    """Write ``run.json``, ``episodes.csv`` and ``table4.csv``.

    ``exploration.csv`` and ``generalization.csv`` come beside them where the run has such
    figures.

    Errors: RunDirectoryError if a file cannot be written.
    """
    saved = save(run, summary, directory.name)
    content = run_json(saved)
    for name, text in _tables(saved).items():
        write_file(directory / name, text)
    # Last: a directory with a run.json has everything else.
    write_file(directory / RUN_FILE, content)
    return saved


def derived_files(run: SavedRun, directory: Path) -> dict[str, str]:
    """Return the texts of a run's tables and of ``report.md`` by file name.

    The report links the videos that lie in the directory.
    """
    report = build_report([run], find_videos(_videos(directory), directory))
    return {**_tables(run), REPORT_FILE: to_markdown(report)}


def read_run(directory: Path) -> SavedRun:
    """Read a run from its directory, or from the path of its ``run.json``.

    Errors: RunDirectoryError with one line that says what is wrong.
    """
    file = directory if directory.name == RUN_FILE else directory / RUN_FILE
    try:
        content = read_file(file)
    except FileNotFoundError as error:
        raise RunDirectoryError(f"{file.parent} is no run: it has no {RUN_FILE}") from error
    except OSError as error:
        raise RunDirectoryError(f"{file} cannot be read: {error.strerror}") from error
    try:
        return parse_run(content, file.resolve().parent.name)
    except RunDirectoryError as error:
        raise RunDirectoryError(f"{file.parent}: {error}") from error


def write_report(
    runs: Sequence[SavedRun],
    directory: Path,
    videos: Sequence[Path] = (),
    names: Sequence[str] | None = None,
) -> Report:
    """Write ``report.md`` and ``report.html`` of one or several runs; return what they show.

    Raises:
        UsageError: runs of different protocols, or names that do not fit them.
        RunDirectoryError: a file cannot be written.
    """
    report = build_report(runs, find_videos(videos, directory), names)
    write_file(directory / REPORT_FILE, to_markdown(report))
    write_file(directory / REPORT_PAGE, to_html(report))
    return report


def _tables(run: SavedRun) -> dict[str, str]:
    """Return the CSV files of a run by name."""
    tables = {EPISODES_FILE: episodes_csv(run.episodes), TABLE4_FILE: csv_text(table4_frame([run]))}
    if run.exploration_episodes:
        tables[EXPLORATION_FILE] = episodes_csv(run.exploration_episodes)
    if run.summary.generalization:
        tables[GENERALIZATION_FILE] = csv_text(generalization_frame([run]))
    return tables


def _videos(directory: Path) -> list[Path]:
    return sorted((directory / VIDEOS).glob("*.mp4"))
