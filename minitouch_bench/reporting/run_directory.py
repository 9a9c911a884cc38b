"""A run's directory: ``run.json``, which every report is drawn from, and the files beside it.

The types are those of ``records``; the schema follows from them and from the table of metrics,
and is published as ``docs/run.schema.json``.
"""

import hashlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from minitouch_bench.documents import read_json, schema_of, write_json
from minitouch_bench.errors import RunDirectoryError, UnreadableFileError
from minitouch_bench.files import (
    EPISODES_FILE,
    EXPLORATION_FILE,
    GENERALIZATION_FILE,
    JOURNAL_FILE,
    REPORT_FILE,
    REPORT_PAGE,
    REPORTS,
    RUN_FILE,
    SUBMISSION_FILE,
    TABLE4_FILE,
    list_videos,
    read_file,
    write_file,
)
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.metric import Metric, ShownIn
from minitouch_bench.metrics.summary import measure_run
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.records import (
    RUN_FORMAT,
    RUN_VERSION,
    EpisodeMetrics,
    EvaluationRun,
    Role,
    RunDocument,
    RunHeader,
    SavedRun,
    Summary,
)
from minitouch_bench.reporting.frames import (
    csv_text,
    episodes_csv,
    generalization_frame,
    table4_frame,
)
from minitouch_bench.reporting.report import ALONE, AcrossRuns, Report, build_report, find_videos
from minitouch_bench.reporting.writers import to_html, to_markdown


@dataclass(frozen=True)
class _Mark:
    """What every version of the document begins with."""

    format: str
    version: int


def save(run: EvaluationRun, summary: Summary, name: str) -> SavedRun:
    """Return a finished run in the form in which it is saved and read back."""
    episodes, exploration = measure_run(run), measure_run(run, Role.EXPLORATION)
    return SavedRun(
        format=RUN_FORMAT,
        version=RUN_VERSION,
        digest=run_digest(run.header, episodes, exploration),
        header=run.header,
        environment=run.environment,
        summary=summary,
        faults={record.spec.key: record.fault for record in run.records if record.fault},
        episodes=episodes,
        exploration_episodes=exploration,
        name=name,
    )


def document_of(run: SavedRun) -> RunDocument:
    """Return what ``run.json`` holds of a run: all but what it is called."""
    return RunDocument(**{field.name: getattr(run, field.name) for field in fields(RunDocument)})


def run_json(run: SavedRun) -> bytes:
    """Write a run as the content of ``run.json``.

    Raises:
        ValueError: it holds NaN or infinity.
    """
    return write_json(document_of(run))


def parse_run(content: bytes, name: str) -> SavedRun:
    """Read a run from the content of its ``run.json``; ``name`` is what it is called.

    Raises:
        RunDirectoryError: it is no run, or of another version.
    """
    mark = read_json(content, _Mark, RUN_FILE)
    if mark.format != RUN_FORMAT:
        raise RunDirectoryError(f"{RUN_FILE}: its format is not '{RUN_FORMAT}'")
    if mark.version != RUN_VERSION:
        raise RunDirectoryError(
            f"{RUN_FILE} has version {mark.version}, this program reads version {RUN_VERSION}; "
            "use the minitouch-bench that wrote it"
        )
    document = read_json(content, RunDocument, RUN_FILE)
    summary = document.summary
    rows = (*document.episodes, *document.exploration_episodes)
    named = {row.task for part in (rows, summary.tasks, summary.generalization) for row in part}
    if unknown := sorted({*document.header.tasks, *named} - set(TASK_NAMES)):
        raise RunDirectoryError(f"{RUN_FILE}: this version has no task {unknown[0]!a}")
    return SavedRun(**vars(document), name=name)


def run_schema() -> dict[str, Any]:
    """Return the JSON schema of ``run.json``."""
    schema = with_task_names(schema_of(RunDocument, "A run of MiniTouch-bench"))
    parts = schema["$defs"]
    for metric in METRICS.values():
        field = parts["EpisodeMetrics"]["properties"].get(metric.measured_field)
        if field is not None and metric.derive is None:
            field["description"] = _described(metric)
    estimates = parts["TaskSummary"]["properties"]["estimates"]
    _name_metrics(estimates, tuple(METRICS.values()))
    gaps = parts["Generalization"]["properties"]["gaps"]
    compared = [metric for metric in METRICS.values() if ShownIn.NOVEL_SHAPES in metric.shown_in]
    _name_metrics(gaps, tuple(compared))
    return schema


def with_task_names(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema whose "task" and "tasks" are names of this protocol's tasks."""
    for part in schema["$defs"].values():
        known = part.get("properties", {})
        if known.get("task") == {"type": "string"}:
            known["task"] = {"enum": list(TASK_NAMES)}
        if known.get("tasks", {}).get("items") == {"type": "string"}:
            known["tasks"]["items"] = {"enum": list(TASK_NAMES)}
    return schema


def _name_metrics(mapping: dict[str, Any], metrics: tuple[Metric, ...]) -> None:
    """Turn a mapping by any key into one by these metrics; one that does not exist has no entry."""
    reference = mapping["additionalProperties"]
    mapping["properties"] = {
        metric.name: {"description": _described(metric), **reference} for metric in metrics
    }
    mapping["additionalProperties"] = False


def _described(metric: Metric) -> str:
    others = {task: unit for task, unit in metric.task_units.items() if unit != metric.unit}
    units = [metric.unit, *(f"{unit} in {task}" for task, unit in others.items())]
    return f"{metric.meaning[:1].upper()}{metric.meaning[1:]}; {', '.join(units)}."


def run_digest(
    header: RunHeader,
    episodes: Iterable[EpisodeMetrics],
    exploration_episodes: Iterable[EpisodeMetrics] = (),
) -> str:
    """Return the SHA-256 over the rules of each task and the episodes, in the run's order.

    Of an episode it covers the task, index, seed, shape, outcome and the trajectory's own
    digest, and so every metric but ``clipped_actions``. It names neither the policy nor the
    machine: whoever gets the same bits gets the same digest.
    """
    rules = (f"{task} {header.task_digests.get(task, '')}" for task in header.tasks)
    sha = hashlib.sha256("\n".join(rules).encode())
    for role, listed in (("final", episodes), ("exploration", exploration_episodes)):
        for episode in listed:
            identity = (role, episode.task, episode.index, episode.seed, episode.shape)
            result = (episode.outcome.value, episode.digest)
            sha.update(("\n" + " ".join(map(str, (*identity, *result)))).encode())
    return sha.hexdigest()


def write_run(run: EvaluationRun, summary: Summary, directory: Path) -> SavedRun:
    """Write ``run.json``, ``episodes.csv`` and ``table4.csv``.

    ``exploration.csv`` and ``generalization.csv`` come beside them where the run has such
    figures.

    Raises:
        RunDirectoryError: a file cannot be written.
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
    report = build_report([run], find_videos(list_videos(directory), directory))
    return {**_tables(run), REPORT_FILE: to_markdown(report)}


def read_run(directory: Path) -> SavedRun:
    """Read a run from its directory, or from the path of its ``run.json``.

    Raises:
        RunDirectoryError: in one line that says what is wrong.
    """
    file = directory if directory.name == RUN_FILE else directory / RUN_FILE
    try:
        content = read_file(file)
    except FileNotFoundError as error:
        if (file.parent / JOURNAL_FILE).exists():
            what = "holds an unfinished run: the command that began it finishes it with --resume"
        elif file.parent.exists():
            what = f"is no run: it has no {RUN_FILE}"
        else:
            what = "is no run: there is no such directory"
        raise RunDirectoryError(f"{file.parent} {what}") from error
    except OSError as error:
        raise UnreadableFileError(f"{file} cannot be read: {error.strerror}") from error
    try:
        return parse_run(content, file.resolve().parent.name)
    except RunDirectoryError as error:
        raise RunDirectoryError(f"{file.parent}: {error}") from error


def view_directory(run: Path) -> Path:
    """Return where reports and videos of a finished run are written: its own directory.

    A submission stays as it is: the views of its runs are written to ``reports/NAME/...``.
    """
    directory = run.parent if run.name == RUN_FILE else run
    submission = directory.resolve().parent.parent
    if not os.path.lexists(submission / SUBMISSION_FILE):
        return directory
    return REPORTS / directory.resolve().relative_to(submission.parent)


def write_report(
    runs: Sequence[SavedRun],
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
