"""What programs read: comparisons and results of the gate as JSON, results as JUnit XML."""

import json
from dataclasses import asdict
from typing import Any
from xml.etree import ElementTree

from minitouch_bench.regression.comparison import Comparison
from minitouch_bench.regression.gate import Decision, GateResult, JudgedMetric
from minitouch_bench.regression.tables import (
    decision_text,
    difference_text,
    effect_head,
    episodes_line,
    gate_notes,
    next_line,
    p_text,
    result_line,
)
from minitouch_bench.rendering.escaping import printable

VERSION = 2
SUITE = "minitouch-bench regress"


def comparison_json(comparison: Comparison) -> str:
    """Write a comparison; the keys are the fields of ``Comparison``."""
    return _text({"format": "minitouch-comparison", "version": VERSION, **asdict(comparison)})


def gate_json(result: GateResult) -> str:
    """Write a gate's result; the keys are the fields of ``GateResult``."""
    found = {
        "format": "minitouch-regression",
        "version": VERSION,
        "exit_code": result.exit_code,
        "episodes_needed": result.episodes_needed,
        **asdict(result),
    }
    for judged in found["judged"]:
        tolerance = result.settings.tolerance(judged["effect"]["task"], judged["effect"]["metric"])
        judged["tolerance_as_set"] = str(tolerance)
    return _text(found)


def _text(document: dict[str, Any]) -> str:
    """Write a document as text; NaN and infinity are refused."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def gate_junit(result: GateResult) -> str:
    """Write a result as a JUnit report, one test case per metric of a task.

    A regression is a failure, and what is inconclusive is skipped, with ``strict`` a failure
    too. Source of the form: the Ant task "JUnitReport", as CI servers read it.
    """
    kinds = [_kind(one, result) for one in result.judged]
    counts = {
        "tests": str(len(kinds)),
        "failures": str(kinds.count("failure")),
        "errors": "0",
        "skipped": str(kinds.count("skipped")),
        "time": "0",
    }
    root = ElementTree.Element("testsuites", {"name": SUITE, **counts})
    suite = ElementTree.SubElement(root, "testsuite", {"name": SUITE, **counts})
    properties = ElementTree.SubElement(suite, "properties")
    for name, value in (
        ("baseline", result.baseline.path),
        ("candidate", result.candidate.path),
        ("alpha", f"{result.settings.alpha:g}"),
        ("result", result_line(result)),
    ):
        ElementTree.SubElement(properties, "property", {"name": name, "value": printable(value)})
    for one, kind in zip(result.judged, kinds, strict=True):
        _add_case(suite, one, kind)
    lines = [episodes_line(result), *gate_notes(result), next_line(result)]
    ElementTree.SubElement(suite, "system-out").text = "\n".join(
        printable(line) for line in lines if line
    )
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _kind(judged: JudgedMetric, result: GateResult) -> str:
    """Return the element that says how a test case ended; a passed one has its output only."""
    if judged.decision is Decision.PASSED:
        return "system-out"
    strict = result.settings.strict and judged.decision is Decision.INCONCLUSIVE
    return "failure" if judged.decision is Decision.REGRESSION or strict else "skipped"


def _add_case(suite: ElementTree.Element, judged: JudgedMetric, kind: str) -> None:
    effect = judged.effect
    difference = difference_text(effect)
    names = {"classname": f"minitouch.{effect.task}", "name": effect.metric, "time": "0"}
    case = ElementTree.SubElement(suite, "testcase", names)
    found = ElementTree.SubElement(case, kind)
    if kind != "system-out":
        found.set("message", printable(f"{decision_text(judged)}: {difference}"))
    if kind == "failure":
        found.set("type", judged.decision.value)
    found.text = printable(
        f"{effect_head(effect)}: candidate minus baseline {difference}, "
        f"tolerance {judged.tolerance:g}, p {p_text(judged.p_adjusted)}, {effect.count} episodes"
    )
