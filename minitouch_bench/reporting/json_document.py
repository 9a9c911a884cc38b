"""``run.json``: the one document of a run that every report is drawn from.

Its schema is published as ``docs/run.schema.json``. Equal runs give equal documents apart
from "environment", which alone holds times.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.metrics.definitions import METRICS, unit_of
from minitouch_bench.metrics.digest import run_digest
from minitouch_bench.metrics.intervals import BOOTSTRAP, NEWCOMBE, WILSON
from minitouch_bench.metrics.summary import measure_run
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.records import (
    EpisodeMetrics,
    Estimate,
    EvaluationRun,
    FamilyResult,
    Gap,
    Generalization,
    Outcome,
    PolicyIdentity,
    Role,
    RunEnvironment,
    RunHeader,
    SavedRun,
    Summary,
    TaskSummary,
)
from minitouch_bench.reporting.json_reader import JsonNode

FORMAT = "minitouch-run"
VERSION = 1


def to_document(run: EvaluationRun, summary: Summary) -> dict[str, Any]:
    """Write a run as a JSON document of plain dicts, lists, strings and numbers."""
    episodes, exploration = measure_run(run), measure_run(run, Role.EXPLORATION)
    return {
        "format": FORMAT,
        "version": VERSION,
        "digest": run_digest(run.header.protocol_digest, episodes, exploration),
        "header": _plain(asdict(run.header)),
        "environment": _plain(asdict(run.environment)),
        "summary": _summary_document(summary),
        "faults": {r.spec.key: r.fault for r in run.records if r.fault},
        "episodes": [_episode_document(e) for e in episodes],
        "exploration_episodes": [_episode_document(e) for e in exploration],
    }


def saved_document(run: SavedRun) -> dict[str, Any]:
    """Write a run that was read back: the document it was read from, if that is as published."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "digest": run.digest,
        "header": _plain(asdict(run.header)),
        "environment": _plain(asdict(run.environment)),
        "summary": _summary_document(run.summary),
        "faults": dict(run.faults),
        "episodes": [_episode_document(e) for e in run.episodes],
        "exploration_episodes": [_episode_document(e) for e in run.exploration_episodes],
    }


def to_text(document: Mapping[str, Any]) -> str:
    """Write a document as the text of ``run.json``; NaN and infinity are refused."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def from_document(document: Any, name: str) -> SavedRun:
    """Read a run back; ``name`` is what it is called, usually its directory's name.

    Errors: RunDirectoryError with one line that says what is wrong.
    """
    node = JsonNode(document, "run.json")
    _check_version(node)
    return SavedRun(
        name=name,
        digest=node["digest"].text(),
        header=_header(node["header"]),
        environment=_environment(node["environment"]),
        summary=_summary(node["summary"]),
        episodes=tuple(_episode(row) for row in node["episodes"]),
        exploration_episodes=tuple(_episode(row) for row in node["exploration_episodes"]),
        faults=node["faults"].text_mapping(),
        document=document,
    )


def _plain(value: Any) -> Any:
    """Return the value with tuples as lists and mappings as dicts."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _summary_document(summary: Summary) -> dict[str, Any]:
    """Write the estimates; a run of one split has no generalisation."""
    document: dict[str, Any] = {"tasks": [_task_document(task) for task in summary.tasks]}
    if summary.generalization:
        document["generalization"] = [_gap_document(task) for task in summary.generalization]
    return document


def _task_document(task: TaskSummary) -> dict[str, Any]:
    """Write one task's summary; each estimate carries its unit."""
    return {
        "task": task.task,
        "outcomes": dict(task.outcomes),
        "estimates": {
            metric: _estimate_document(estimate, unit_of(metric, task.task))
            for metric, estimate in task.estimates.items()
        },
        "touch_curve": {
            "mean_contact_ticks": list(task.touch_curve),
            "episodes": list(task.touch_curve_episodes),
        },
    }


def _estimate_document(estimate: Estimate, unit: str) -> dict[str, Any]:
    """Write one estimate with its unit."""
    return {**asdict(estimate), "unit": unit}


def _gap_document(result: Generalization) -> dict[str, Any]:
    """Write one task's held-out and train figures, the gaps, and the families."""
    family_unit = unit_of(result.family_metric, result.task)
    return {
        "task": result.task,
        "gaps": {
            metric: {
                "held_out": _estimate_document(gap.held_out, unit_of(metric, result.task)),
                "train": _estimate_document(gap.train, unit_of(metric, result.task)),
                "difference": _estimate_document(gap.difference, unit_of(metric, result.task)),
            }
            for metric, gap in result.gaps.items()
        },
        "family_metric": result.family_metric,
        "families": {
            family: {
                split: None if estimate is None else _estimate_document(estimate, family_unit)
                for split, estimate in (("held_out", found.held_out), ("train", found.train))
            }
            for family, found in result.families.items()
        },
    }


def _episode_document(episode: EpisodeMetrics) -> dict[str, Any]:
    """Write one episode under the column names of ``episodes.csv``."""
    row = {column: getattr(episode, name) for column, name in EpisodeMetrics.columns().items()}
    return {**row, "outcome": episode.outcome.value}


def _check_version(node: JsonNode) -> None:
    """Refuse what is no run, or a run of a later version."""
    if node["format"].text() != FORMAT:
        raise RunDirectoryError(f"run.json: its format is not '{FORMAT}'")
    version = node["version"].integer()
    if version != VERSION:
        raise RunDirectoryError(
            f"run.json has version {version}, this program reads version {VERSION}; "
            "use the minitouch-bench that wrote it"
        )


def _header(node: JsonNode) -> RunHeader:
    """Read the header."""
    exploration = node["exploration"]
    return RunHeader(
        protocol=node["protocol"].text(),
        protocol_digest=node["protocol_digest"].text(),
        suite=node["suite"].text(),
        official=node["official"].flag(),
        unofficial_because=node["unofficial_because"].texts(),
        tasks=tuple(task.choice(TASK_NAMES) for task in node["tasks"]),
        episodes=node["episodes"].count(),
        seed=node["seed"].count(),
        policy=_policy(node["policy"]),
        exploration=None if exploration.is_null else _policy(exploration),
        act_timeout_s=node["act_timeout_s"].number(),
        isolation=node["isolation"].text(),
    )


def _policy(node: JsonNode) -> PolicyIdentity:
    """Read what was evaluated."""
    return PolicyIdentity(
        name=node["name"].text(),
        source=node["source"].text(),
        kind=node["kind"].text(),
        digest=node["digest"].text(),
        notes=node["notes"].texts(),
    )


def _environment(node: JsonNode) -> RunEnvironment:
    """Read where and when the run was made."""
    return RunEnvironment(
        packages=node["packages"].text_mapping(),
        machine=node["machine"].text_mapping(),
        workers=node["workers"].count(),
        started=node["started"].text(),
        wall_s=node["wall_s"].number(),
    )


def _summary(node: JsonNode) -> Summary:
    """Read the estimates."""
    generalization = node.mapping().get("generalization")
    return Summary(
        tasks=tuple(_task_summary(task) for task in node["tasks"]),
        generalization=()
        if generalization is None
        else tuple(_generalization(task) for task in generalization),
    )


def _generalization(node: JsonNode) -> Generalization:
    """Read one task's held-out and train figures."""
    gaps = node["gaps"].mapping()
    return Generalization(
        task=node["task"].choice(TASK_NAMES),
        gaps={name: _gap(gaps[name]) for name in gaps if name in METRICS},
        family_metric=node["family_metric"].choice(tuple(METRICS)),
        families={
            family: FamilyResult(
                held_out=_estimate_or_none(found["held_out"]),
                train=_estimate_or_none(found["train"]),
            )
            for family, found in node["families"].mapping().items()
        },
    )


def _gap(node: JsonNode) -> Gap:
    """Read one metric's gap."""
    return Gap(
        held_out=_estimate(node["held_out"]),
        train=_estimate(node["train"]),
        difference=_estimate(node["difference"]),
    )


def _task_summary(node: JsonNode) -> TaskSummary:
    """Read one task's summary; metrics of a later minor version are left out."""
    estimates = node["estimates"].mapping()
    outcomes = node["outcomes"].mapping()
    curve = node["touch_curve"]
    return TaskSummary(
        task=node["task"].choice(TASK_NAMES),
        estimates={name: _estimate(estimates[name]) for name in METRICS if name in estimates},
        outcomes={o.value: outcomes[o].count() for o in Outcome if o in outcomes},
        touch_curve=tuple(value.number() for value in curve["mean_contact_ticks"]),
        touch_curve_episodes=tuple(value.count() for value in curve["episodes"]),
    )


def _estimate(node: JsonNode) -> Estimate:
    """Read one estimate."""
    return Estimate(
        value=node["value"].number(),
        low=node["low"].number(),
        high=node["high"].number(),
        count=node["count"].count(),
        method=node["method"].choice((WILSON, NEWCOMBE, BOOTSTRAP)),
    )


def _estimate_or_none(node: JsonNode) -> Estimate | None:
    """Read one estimate, null where there is none."""
    return None if node.is_null else _estimate(node)


def _episode(node: JsonNode) -> EpisodeMetrics:
    """Read one episode."""
    first_touch = node["time_to_first_touch"]
    return EpisodeMetrics(
        task=node["task"].choice(TASK_NAMES),
        index=node["index"].count(),
        seed=node["seed"].count(),
        shape=node["shape"].text(),
        outcome=Outcome(node["outcome"].choice(tuple(Outcome))),
        success=node["success"].flag(),
        steps=node["steps"].count(),
        episode_return=node["return"].number(),
        touch_interaction=node["touch_interaction"].count(),
        touch_onsets=node["touch_onsets"].count(),
        touch_steps=node["touch_steps"].count(),
        touch_variance=node["touch_variance"].number(),
        object_movement=node["object_movement"].number(),
        time_to_first_touch=None if first_touch.is_null else first_touch.number(),
        arm_time=node["arm_time"].number(),
        clipped_actions=node["clipped_actions"].count(),
        family=node["family"].text(),
        split=node["split"].text(),
        digest=node["digest"].text(),
    )
