"""A report of one or several runs as data, and the views of a run; the writers add only form."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from urllib.parse import quote

from minitouch_bench import files
from minitouch_bench.errors import UsageError, printable
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.reporting.labels import RunSection, describe_runs, tasks_in_order
from minitouch_bench.reporting.run_tables import (
    diagnostics,
    episode_table,
    novel_shapes,
    table4,
)
from minitouch_bench.reporting.tables import Table
from minitouch_bench.runs.results import TABLE4_METRICS
from minitouch_bench.runs.run import Run


@dataclass(frozen=True)
class Video:
    """A video beside the report: its caption, and its address relative to the report."""

    caption: str
    address: str


@dataclass(frozen=True)
class Shown:
    """What a report shows of its runs: ``tasks`` and ``metrics`` of Table 4; () for the usual.

    ``names``: what the runs are called; by default by their policies.
    """

    names: Sequence[str] | None = None
    tasks: Sequence[str] = ()
    metrics: Sequence[str] = ()


USUAL = Shown()


@dataclass(frozen=True)
class Report:
    """What every writer of a report shows.

    ``metrics``: the rows of Table 4. ``novel_shapes``: the gaps and the families, empty where no
    run has both splits. ``episodes``: a table per run.
    """

    title: str
    tasks: tuple[str, ...]
    metrics: tuple[str, ...]
    sections: tuple[RunSection, ...]
    table4: Table
    diagnostics: Table
    novel_shapes: tuple[Table, ...]
    episodes: tuple[Table, ...]
    videos: tuple[Video, ...]


def build_report(runs: Sequence[Run], videos: Sequence[Video] = (), shown: Shown = USUAL) -> Report:
    """Compose the report of one or several runs.

    Raises:
        UsageError: no runs; runs of which a task was played by other rules; names that do not fit
            the runs; a task that no run has, or a metric that does not exist.
    """
    if not runs:
        raise UsageError("a report needs at least one run")
    _check_protocols(runs)
    sections = describe_runs(runs, shown.names)
    tasks = _chosen("task", shown.tasks, tasks_in_order(runs))
    metrics = _chosen("metric", shown.metrics, tuple(METRICS)) if shown.metrics else TABLE4_METRICS
    return Report(
        title=" · ".join(section.name for section in sections),
        tasks=tasks,
        metrics=metrics,
        sections=sections,
        table4=table4(sections, tasks, metrics),
        diagnostics=diagnostics(sections, tasks),
        novel_shapes=novel_shapes(sections, tasks),
        episodes=tuple(episode_table(section, tasks) for section in sections),
        videos=tuple(videos),
    )


def _chosen(what: str, asked: Sequence[str], known: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names asked for, in the order of the known ones; all where none is asked for."""
    if unknown := [name for name in asked if name not in known]:
        raise UsageError(f"no {what} '{unknown[0]}' in these runs; there are {', '.join(known)}")
    return tuple(name for name in known if name in asked) if asked else known


def find_videos(videos: Sequence[Path], directory: Path) -> tuple[Video, ...]:
    """Describe video files for a report that will stand in ``directory``."""
    return tuple(
        Video(
            caption=printable(file.stem.replace("_", " ")),
            address=quote(Path(os.path.relpath(file, directory)).as_posix()),
        )
        for file in sorted(videos)
    )


def _check_protocols(runs: Sequence[Run]) -> None:
    for first, other in combinations(runs, 2):
        if tasks := first.header.rules_differ(other.header):
            raise UsageError(
                f"{_protocol_of(first)} and {_protocol_of(other)} cannot be in one table: "
                f"the rules of {', '.join(tasks)} differ"
            )


def _protocol_of(run: Run) -> str:
    header = run.header
    return f"'{run.name}' ({header.protocol}, {header.protocol_digest[:12]})"


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
