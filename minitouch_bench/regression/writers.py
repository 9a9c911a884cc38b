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

COMPARISON_VERSION, RESULT_VERSION = 2, 3
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
    """Write a result as a JUnit report: a test case for what decides, and its time.

    Not enough episodes are a failure where the gate fails, otherwise skipped. After a regression
    each metric of a task is a test case too. Source of the form: the Ant task "JUnitReport", as CI
    servers read it.
    """
    tested = [metric for metric in result.per_task if metric.p_adjusted is not None]
    kinds = [_kind(result), *("failure" if metric.is_worse else "system-out" for metric in tested)]
    counts = {
        "tests": str(len(kinds)),
        "failures": str(kinds.count("failure")),
        "errors": "0",
        "skipped": str(kinds.count("skipped")),
        "time": f"{result.wall_s:.3f}",
    }
    root = ElementTree.Element("testsuites", {"name": SUITE, **counts})
    suite = ElementTree.SubElement(root, "testsuite", {"name": SUITE, **counts})
    properties = ElementTree.SubElement(suite, "properties")
    for name, value in (
        ("baseline", result.baseline.path),
        ("candidate", result.candidate.path),
        ("alpha", f"{result.settings.alpha:g}"),
        ("result", tables.result_line(result)),
    ):
        ElementTree.SubElement(properties, "property", {"name": name, "value": printable(value)})
    endpoint = result.endpoint
    case = _add_case(suite, endpoint.effect, kinds[0], tables.result_line(result), endpoint.p_value)
    case.set("time", counts["time"])
    for metric, kind in zip(tested, kinds[1:], strict=True):
        assert metric.p_adjusted is not None
        _add_case(suite, metric.effect, kind, "worse", metric.p_adjusted)
    lines = [
        tables.episodes_line(result),
        *tables.gate_notes(result),
        f"next: {result.next_command}",
    ]
    ElementTree.SubElement(suite, "system-out").text = "\n".join(
        printable(line) for line in lines if line
    )
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _kind(result: GateResult) -> str:
    """Return the element that says how the gate ended; a passed one has its output only."""
    if result.exit_code:
        return "failure"
    return "skipped" if result.decision is Decision.NOT_ENOUGH else "system-out"


def _add_case(
    suite: ElementTree.Element, effect: Effect, kind: str, words: str, p_value: float
) -> ElementTree.Element:
    difference = tables.difference_text(effect)
    names = {"classname": f"minitouch.{effect.task}", "name": effect.metric}
    case = ElementTree.SubElement(suite, "testcase", names)
    element = ElementTree.SubElement(case, kind)
    if kind != "system-out":
        element.set("message", printable(f"{words}: {difference}"))
    if kind == "failure":
        element.set("type", printable(words.partition(":")[0]))
    element.text = printable(
        f"{tables.effect_head(effect)}: candidate minus baseline {difference}, "
        f"p {tables.p_text(p_value)}, {effect.count} episodes"
    )
    return case
