"""Write the published schemas, which follow from the types: ``make schemas``."""

import json
from pathlib import Path
from typing import Any

import msgspec

from minitouch_bench.leaderboard.board import Board
from minitouch_bench.leaderboard.submission import Submission
from minitouch_bench.metrics.definitions import METRICS, Metric, ShownIn
from minitouch_bench.perturbation import Perturbation
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.runs.run import RunDocument

DOCS = Path(__file__).parent.parent / "docs"
DRAFT = "https://json-schema.org/draft/2020-12/schema"


def main() -> None:
    schemas = {"run": run_schema, "submission": submission_schema, "leaderboard": board_schema}
    for name, schema in schemas.items():
        text = json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"
        (DOCS / f"{name}.schema.json").write_text(text, encoding="utf-8")


def run_schema() -> dict[str, Any]:
    """Return the JSON schema of ``run.json``."""
    schema = with_task_names(schema_of(RunDocument, "A run of MiniTouch-bench"))
    parts = schema["$defs"]
    for metric in METRICS.values():
        field = parts["Episode"]["properties"].get(metric.measured_field)
        if field is not None and (not metric.derive or metric.column == metric.measured_field):
            field["description"] = _described(metric)
    estimates = parts["TaskResult"]["properties"]["estimates"]
    _name_metrics(estimates, tuple(METRICS.values()))
    gaps = parts["Generalization"]["properties"]["gaps"]
    compared = [metric for metric in METRICS.values() if ShownIn.NOVEL_SHAPES in metric.shown_in]
    _name_metrics(gaps, tuple(compared))
    return schema


def submission_schema() -> dict[str, Any]:
    """Return the JSON schema of ``submission.toml``, as the JSON value a TOML reader gives."""
    return schema_of(Submission, "A submission to the MiniTouch leaderboard")


def board_schema() -> dict[str, Any]:
    """Return the JSON schema of ``leaderboard.json``."""
    return with_task_names(schema_of(Board, "The MiniTouch leaderboard"))


def schema_of(kind: type, title: str) -> dict[str, Any]:
    """Return the JSON schema of what ``write_json`` writes of a record.

    Every record has all its keys, but those that are unset or of conditions that are as usual, and
    no other one; its description is its docstring.
    """
    (root,), parts = msgspec.json.schema_components([kind], ref_template="#/$defs/{name}")
    for name, part in parts.items():
        if "description" in part:
            lines = part["description"].replace("``", "'").split()
            part["description"] = " ".join(lines)
        if "properties" in part:
            properties, without_default = part["properties"], part.get("required", ())
            part["required"] = [
                key
                for key, entry in properties.items()
                if key in without_default or ("default" in entry and name != Perturbation.__name__)
            ]
            part["additionalProperties"] = False
            for entry in properties.values():
                entry.pop("default", None)
    whole = parts.pop(root["$ref"].rpartition("/")[2])
    whole.pop("title")
    return {"$schema": DRAFT, "title": title, **whole, "$defs": parts}


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


if __name__ == "__main__":
    main()
