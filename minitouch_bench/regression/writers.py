"""A comparison and a gate's result: on a terminal, as Markdown, as JSON and as JUnit XML."""

import json
from dataclasses import asdict
from typing import Any
from xml.etree import ElementTree

from rich.console import Console
from rich.text import Text

from minitouch_bench.errors import printable
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.regression import tables
from minitouch_bench.regression.comparison import Comparison
from minitouch_bench.regression.gate import Decision, GateResult
from minitouch_bench.regression.paired_tests import Effect
from minitouch_bench.regression.tables import comparison_blocks
from minitouch_bench.reporting.formats import (
    as_markdown,
    as_text,
    code_span,
    escape_md,
    on_screen,
)

SHOWN_CHANGES, SUMMARY_CHANGES = 20, 50
"""Changed episodes that a screen and a result's page list; the JSON has all of them."""

STYLES = {
    Decision.NO_REGRESSION: "bold green",
    Decision.REGRESSION: "bold red",
    Decision.NOT_ENOUGH: "bold yellow",
}
MARKS = {Decision.NO_REGRESSION: "✅", Decision.REGRESSION: "❌", Decision.NOT_ENOUGH: "❔"}

COMPARISON_VERSION, RESULT_VERSION = 3, 4
"""Of the JSON documents."""

SUITE = "minitouch-bench regress"


def show_comparison(comparison: Comparison, console: Console) -> None:
    """Print a comparison."""
    console.print(on_screen(comparison_blocks(comparison, SHOWN_CHANGES)))


def comparison_text(comparison: Comparison) -> str:
    """Return what a terminal shows of a comparison."""
    return as_text(comparison_blocks(comparison, SHOWN_CHANGES))


def comparison_markdown(comparison: Comparison) -> str:
    """Write a comparison as a page, with every changed episode."""
    lines = as_markdown(comparison_blocks(comparison, MAX_EPISODES))
    return "\n".join(["# Comparison of runs", "", *lines]) + "\n"


def show_result(result: GateResult, console: Console) -> None:
    """Print a gate's result; the last two lines are the answer, and what to type next."""
    titles = (result.baseline.title, result.candidate.title)
    changes = tables.changes_blocks(result.changes, titles, SHOWN_CHANGES)
    console.print(on_screen((*tables.result_blocks(result), *changes, "")))
    console.print(Text(tables.result_line(result), style=STYLES[result.decision]), soft_wrap=True)
    console.print(Text(f"next: {result.next_command}"), soft_wrap=True)


def gate_markdown(result: GateResult) -> str:
    """Write a result as a section of a page, such as a GitHub step summary."""
    answer = escape_md(tables.result_line(result))
    lines = [f"## {MARKS[result.decision]} minitouch-bench {answer}", ""]
    lines += [f"- next: {code_span(result.next_command)}"]
    lines += as_markdown(tables.result_blocks(result))
    if result.changes:
        titles = (result.baseline.title, result.candidate.title)
        title = f"{len(result.changes)} episodes ended in another way"
        lines += ["", f"<details><summary>{title}</summary>"]
        lines += as_markdown(tables.changes_blocks(result.changes, titles, SUMMARY_CHANGES))
        lines += ["", "</details>"]
    return "\n".join(lines) + "\n"


def comparison_json(comparison: Comparison) -> str:
    """Write a comparison; the keys are the fields of ``Comparison``."""
    return _text(
        {"format": "minitouch-comparison", "version": COMPARISON_VERSION, **asdict(comparison)}
    )


def gate_json(result: GateResult) -> str:
    """Write a gate's result; the keys are the fields of ``GateResult``."""
    document = {
        "format": "minitouch-regression",
        "version": RESULT_VERSION,
        "exit_code": result.exit_code,
        **asdict(result),
    }
    return _text(document)


def _text(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def gate_junit(result: GateResult) -> str:
    """Write a result as a JUnit report: the gate's own test case, and one per metric of a task.

    The names of the cases depend on the baseline's tasks and metrics alone, not on the outcome.
    Not enough episodes are a failure where the gate fails, otherwise skipped. A metric of a task is
    skipped unless there is a regression, after which alone it is tested. Source of the form: the
    Ant task "JUnitReport", as CI servers read it.
    """
    answer, endpoint = tables.result_line(result), result.endpoint
    cases = [_case("gate", endpoint.effect, _kind(result), answer, endpoint.p_value)]
    cases[0].set("name", f"{endpoint.effect.task} {endpoint.effect.metric}")
    cases[0].set("time", f"{result.wall_s:.3f}")
    for metric in result.per_task:
        kind, words = "failure" if metric.is_worse else "system-out", "worse"
        if metric.p_adjusted is None:
            kind, words = "skipped", "tested only after a regression"
        cases.append(_case(metric.effect.task, metric.effect, kind, words, metric.p_adjusted))
    counts = {
        "tests": str(len(cases)),
        "failures": str(sum(case.find("failure") is not None for case in cases)),
        "errors": "0",
        "skipped": str(sum(case.find("skipped") is not None for case in cases)),
        "time": f"{result.wall_s:.3f}",
    }
    root = ElementTree.Element("testsuites", {"name": SUITE, **counts})
    suite = ElementTree.SubElement(root, "testsuite", {"name": SUITE, **counts})
    properties = ElementTree.SubElement(suite, "properties")
    for name, value in (
        ("baseline", result.baseline.path),
        ("candidate", result.candidate.path),
        ("alpha", f"{result.settings.alpha:g}"),
        ("result", answer),
    ):
        ElementTree.SubElement(properties, "property", {"name": name, "value": printable(value)})
    suite.extend(cases)
    lines = [*tables.gate_notes(result), f"next: {result.next_command}"]
    ElementTree.SubElement(suite, "system-out").text = "\n".join(map(printable, lines))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _kind(result: GateResult) -> str:
    """Return the element that says how the gate ended; a passed one has its output only."""
    if result.exit_code:
        return "failure"
    return "skipped" if result.decision is Decision.NOT_ENOUGH else "system-out"


def _case(
    group: str, effect: Effect, kind: str, words: str, p_value: float | None
) -> ElementTree.Element:
    """Return a test case, with an element ``kind`` that says how it ended."""
    difference = tables.difference_text(effect)
    case = ElementTree.Element(
        "testcase", {"classname": f"minitouch.{group}", "name": effect.metric}
    )
    element = ElementTree.SubElement(case, kind)
    if kind != "system-out":
        element.set("message", printable(f"{words}: {difference}"))
    if kind == "failure":
        element.set("type", printable(words.partition(":")[0]))
    tested = "not tested" if p_value is None else f"p {tables.p_text(p_value)}"
    element.text = printable(
        f"{tables.effect_head(effect)}: candidate minus baseline {difference}, {tested}, "
        f"{effect.count} episodes"
    )
    return case
