"""Comparisons and verdicts as JSON: plain dicts, lists, strings and numbers."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.regression.comparison import Change, Comparison, Entrant, Finding, Versus
from minitouch_bench.regression.effects import Effect
from minitouch_bench.regression.gate import Judgement, Side, Verdict

COMPARISON_FORMAT = "minitouch-comparison"
VERDICT_FORMAT = "minitouch-regression"
VERSION = 1


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """Write a comparison."""
    return {
        "format": COMPARISON_FORMAT,
        "version": VERSION,
        "alpha": comparison.alpha,
        "runs": [_entrant(entrant) for entrant in comparison.entrants],
        "comparisons": [_versus(versus) for versus in comparison.pairs],
    }


def verdict_document(verdict: Verdict) -> dict[str, Any]:
    """Write a gate's verdict."""
    settings = verdict.settings
    return {
        "format": VERDICT_FORMAT,
        "version": VERSION,
        "verdict": verdict.ruling.value,
        "exit_code": verdict.exit_code,
        "identical": verdict.identical,
        "needed_episodes": verdict.needed,
        "alpha": settings.alpha,
        "strict": settings.strict,
        "baseline": _side(verdict.baseline),
        "candidate": _side(verdict.candidate),
        "judgements": [_judgement(one, verdict) for one in verdict.judgements],
        "changes": [_change(change) for change in verdict.changes],
        "notes": list(verdict.notes),
        "sequential": None if verdict.effort is None else asdict(verdict.effort),
    }


def to_text(document: Mapping[str, Any]) -> str:
    """Write a document as text; NaN and infinity are refused."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _entrant(entrant: Entrant) -> dict[str, Any]:
    return {
        "letter": entrant.letter,
        "name": entrant.name,
        "place": entrant.place,
        "labels": list(entrant.labels),
    }


def _side(side: Side) -> dict[str, Any]:
    return {"name": side.name, "place": side.place, "labels": list(side.labels)}


def _versus(versus: Versus) -> dict[str, Any]:
    return {
        "first": versus.first.letter,
        "second": versus.second.letter,
        "identical": versus.identical,
        "findings": [_finding(finding) for finding in versus.findings],
        "changes": [_change(change) for change in versus.changes],
        "notes": list(versus.notes),
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        **_effect(finding.effect),
        "p_holm": finding.p_holm,
        "verdict": finding.verdict,
        "episodes_to_resolve": finding.needed,
        "detectable_difference": finding.detectable,
    }


def _judgement(judgement: Judgement, verdict: Verdict) -> dict[str, Any]:
    effect = judgement.effect
    return {
        **_effect(effect),
        "p_adjusted": judgement.p_value,
        "tolerance": judgement.allowed,
        "tolerance_as_set": str(verdict.settings.tolerance(effect.task, effect.metric)),
        "judgement": judgement.ruling.value,
        "needed_episodes": judgement.needed,
    }


def _effect(effect: Effect) -> dict[str, Any]:
    difference = asdict(effect.difference)
    return {
        "task": effect.task,
        "metric": effect.metric,
        "unit": METRICS[effect.metric].unit,
        "first": effect.first,
        "second": effect.second,
        "difference": difference,
        "p_value": effect.p_value,
        "differing_episodes": effect.differing,
    }


def _change(change: Change) -> dict[str, Any]:
    return {
        "episode": change.key,
        "first": change.first.value,
        "second": change.second.value,
        "replay": list(change.replays),
    }
