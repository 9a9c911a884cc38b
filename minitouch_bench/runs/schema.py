"""The JSON schema of ``run.json``: it follows from its types and from the table of metrics."""

from typing import Any

from minitouch_bench.documents import schema_of
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.metric import Metric, ShownIn
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.runs.run import RunDocument


def run_schema() -> dict[str, Any]:
    """Return the JSON schema of ``run.json``."""
    schema = with_task_names(schema_of(RunDocument, "A run of MiniTouch-bench"))
    parts = schema["$defs"]
    for metric in METRICS.values():
        field = parts["EpisodeMetrics"]["properties"].get(metric.measured_field)
        if field is not None and (not metric.derive or metric.column == metric.measured_field):
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
