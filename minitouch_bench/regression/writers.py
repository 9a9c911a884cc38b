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
from minitouch_bench.regression.gate import Decision, GateResult
from minitouch_bench.regression.paired_tests import Effect
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.markdown import code_span, escape, table_lines
from minitouch_bench.reporting.writers import draw_table

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
    """Print a gate's result; the last two lines are the answer, and what to type next."""
    titles = (result.baseline.title, result.candidate.title)
    parts: list[RenderableType] = [
        Text(tables.run_line(result.baseline)),
        Text(tables.run_line(result.candidate)),
        Text(),
        draw_table(tables.endpoint_table(result)),
        *(draw_table(table) for table in tables.task_tables(result)),
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
    for table in (tables.endpoint_table(result), tables.task_table(result)):
        parts += ["", f"### {escape(table.title)}", "", *table_lines(table)]
    parts.append("")
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
    return _text(
        {"format": "minitouch-comparison", "version": COMPARISON_VERSION, **asdict(comparison)}
    )


def gate_json(result: GateResult) -> str:
    """Write a gate's result; the keys are the fields of ``GateResult``."""
    found = {
        "format": "minitouch-regression",
        "version": RESULT_VERSION,
        "exit_code": result.exit_code,
        **asdict(result),
    }
    return _text(found)


def _text(document: dict[str, Any]) -> str:
    """Write a document as text; NaN and infinity are refused."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def gate_junit(result: GateResult) -> str:
    """Write a result as a JUnit report: a test case for what decides, and its time.

    Not enough episodes are a failure where the gate fails, otherwise skipped. After a regression
    each metric of a task is a test case too. Source of the form: the Ant task "JUnitReport", as CI
    servers read it.
    """
    tested = [one for one in result.per_task if one.p_adjusted is not None]
    kinds = [_kind(result), *("failure" if one.is_worse else "system-out" for one in tested)]
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
    for one, kind in zip(tested, kinds[1:], strict=True):
        assert one.p_adjusted is not None
        _add_case(suite, one.effect, kind, "worse", one.p_adjusted)
    lines = [tables.episodes_line(result), *tables.gate_notes(result), tables.next_line(result)]
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
    found = ElementTree.SubElement(case, kind)
    if kind != "system-out":
        found.set("message", printable(f"{words}: {difference}"))
    if kind == "failure":
        found.set("type", printable(words.partition(":")[0]))
    found.text = printable(
        f"{tables.effect_head(effect)}: candidate minus baseline {difference}, "
        f"p {tables.p_text(p_value)}, {effect.count} episodes"
    )
    return case
