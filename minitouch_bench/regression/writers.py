"""A comparison and a gate's result: on a terminal, as Markdown, as JSON and as JUnit XML."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any
from xml.etree import ElementTree

from rich.console import Console, Group, RenderableType
from rich.text import Text

from minitouch_bench.regression import tables
from minitouch_bench.regression.comparison import Comparison, OutcomeChange
from minitouch_bench.regression.gate import Decision, GateResult, JudgedMetric
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.markdown import code_span, escape, table_lines
from minitouch_bench.reporting.writers import draw_table

SHOWN_CHANGES, SUMMARY_CHANGES = 20, 50
"""Changed episodes that a screen and a result's page list; the JSON has all of them."""

STYLES = {
    Decision.PASSED: "bold green",
    Decision.REGRESSION: "bold red",
    Decision.INCONCLUSIVE: "bold",
}
MARKS = {Decision.PASSED: "✅", Decision.REGRESSION: "❌", Decision.INCONCLUSIVE: "❔"}

VERSION = 2
"""Of the JSON documents."""

SUITE = "minitouch-bench regress"


def show_comparison(comparison: Comparison, console: Console) -> None:
    """Print a comparison; text is never read as markup."""
    parts: list[RenderableType] = [Text(tables.run_line(run)) for run in comparison.runs]
    for one in comparison.pairs:
        title = f"{one.second} against {one.first}"
        parts += [Text(), Text(title, style="bold underline")]
        parts += [Text(line) for line in tables.comparison_lines(one)]
        parts += [draw_table(table) for table in tables.comparison_tables(one)]
        parts += _changes_on_screen(one.changes, (one.first, one.second))
    parts += [Text(), *(Text(note, style="dim") for note in tables.comparison_notes(comparison))]
    console.print(Group(*parts))


def show_result(result: GateResult, console: Console) -> None:
    """Print a gate's result; the last two lines are PASS or FAIL, and what to type next."""
    titles = (result.baseline.title, result.candidate.title)
    parts: list[RenderableType] = [
        Text(tables.run_line(result.baseline)),
        Text(tables.run_line(result.candidate)),
        Text(),
        *(draw_table(table) for table in tables.gate_tables(result)),
        *_changes_on_screen(result.changes, titles),
        Text(),
        *(Text(note, style="dim") for note in tables.gate_notes(result)),
        Text(),
    ]
    console.print(Group(*parts))
    if line := tables.episodes_line(result):
        console.print(Text(line), soft_wrap=True)
    console.print(Text(tables.result_line(result), style=STYLES[result.decision]), soft_wrap=True)
    console.print(Text(tables.next_line(result)), soft_wrap=True)


def _changes_on_screen(
    changes: Sequence[OutcomeChange], titles: tuple[str, str]
) -> list[RenderableType]:
    if not changes:
        return []
    more = len(changes) - SHOWN_CHANGES
    parts: list[RenderableType] = [
        Text(),
        draw_table(tables.changes_table(changes[:SHOWN_CHANGES], titles)),
    ]
    if more > 0:
        parts.append(Text(f"and {more} more; --json has all of them", style="dim"))
    return parts


def comparison_markdown(comparison: Comparison) -> str:
    """Write a comparison as a page."""
    parts = ["# Comparison of runs", ""]
    parts += [f"- {escape(tables.run_line(run))}" for run in comparison.runs]
    for one in comparison.pairs:
        titles = (one.first, one.second)
        parts += ["", f"## {titles[1]} against {titles[0]}"]
        for line in tables.comparison_lines(one):
            parts += ["", escape(line)]
        for table in tables.comparison_tables(one):
            parts += ["", f"### {escape(table.title)}", "", *table_lines(table)]
        parts += ["", "### Episodes that ended in another way", ""]
        parts += _markdown_changes(one.changes, titles, len(one.changes))
    parts += ["", *(f"- {escape(note)}" for note in tables.comparison_notes(comparison))]
    return "\n".join(parts) + "\n"


def gate_markdown(result: GateResult) -> str:
    """Write a result as a section of a page, such as a GitHub step summary."""
    parts = [
        f"## {MARKS[result.decision]} minitouch-bench {escape(tables.result_line(result))}",
        "",
    ]
    parts += [f"- {escape(tables.run_line(run))}" for run in (result.baseline, result.candidate)]
    if line := tables.episodes_line(result):
        parts.append(f"- {escape(line)}")
    parts.append(f"- next: {code_span(result.next_command)}")
    parts += ["", *table_lines(tables.gate_table(result)), ""]
    parts += [f"- {escape(note)}" for note in tables.gate_notes(result)]
    if result.changes:
        title = f"{len(result.changes)} episodes ended in another way"
        titles = (result.baseline.title, result.candidate.title)
        parts += ["", f"<details><summary>{title}</summary>", ""]
        parts += _markdown_changes(result.changes, titles, SUMMARY_CHANGES)
        parts += ["", "</details>"]
    return "\n".join(parts) + "\n"


def _markdown_changes(
    changes: Sequence[OutcomeChange], titles: tuple[str, str], most: int
) -> list[str]:
    if not changes:
        return ["None."]
    lines = table_lines(tables.changes_table(changes[:most], titles))
    if len(changes) > most:
        lines += ["", f"and {len(changes) - most} more."]
    return lines


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
        ("result", tables.result_line(result)),
    ):
        ElementTree.SubElement(properties, "property", {"name": name, "value": printable(value)})
    for one, kind in zip(result.judged, kinds, strict=True):
        _add_case(suite, one, kind)
    lines = [tables.episodes_line(result), *tables.gate_notes(result), tables.next_line(result)]
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
    difference = tables.difference_text(effect)
    names = {"classname": f"minitouch.{effect.task}", "name": effect.metric, "time": "0"}
    case = ElementTree.SubElement(suite, "testcase", names)
    found = ElementTree.SubElement(case, kind)
    if kind != "system-out":
        found.set("message", printable(f"{tables.decision_text(judged)}: {difference}"))
    if kind == "failure":
        found.set("type", judged.decision.value)
    found.text = printable(
        f"{tables.effect_head(effect)}: candidate minus baseline {difference}, "
        f"tolerance {judged.tolerance:g}, p {tables.p_text(judged.p_adjusted)}, "
        f"{effect.count} episodes"
    )
