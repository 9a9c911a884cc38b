"""``run.json``: the one document of a run that every report is drawn from.

Its types are those of ``records``; its schema follows from them and from the table of metrics,
and is published as ``docs/run.schema.json``.
"""

from dataclasses import dataclass, fields
from typing import Any, Final

from minitouch_bench.documents import read_json, schema_of, write_json
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import RUN_FILE
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.digest import run_digest
from minitouch_bench.metrics.metric import Metric, ShownIn
from minitouch_bench.metrics.summary import measure_run
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.records import EvaluationRun, Role, RunDocument, SavedRun, Summary

FORMAT: Final = "minitouch-run"
VERSION: Final = 2


@dataclass(frozen=True)
class _Mark:
    """What every version of the document begins with."""

    format: str
    version: int


def save(run: EvaluationRun, summary: Summary, name: str) -> SavedRun:
    """Return a finished run in the form in which it is saved and read back."""
    episodes, exploration = measure_run(run), measure_run(run, Role.EXPLORATION)
    return SavedRun(
        format=FORMAT,
        version=VERSION,
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
    if mark.format != FORMAT:
        raise RunDirectoryError(f"{RUN_FILE}: its format is not '{FORMAT}'")
    if mark.version != VERSION:
        raise RunDirectoryError(
            f"{RUN_FILE} has version {mark.version}, this program reads version {VERSION}; "
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
        field = parts["EpisodeMetrics"]["properties"].get(metric.field or metric.name)
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
