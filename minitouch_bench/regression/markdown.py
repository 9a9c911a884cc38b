"""Comparisons and results of the gate as GitHub's Markdown."""

from collections.abc import Sequence

from minitouch_bench.regression.comparison import Comparison, OutcomeChange
from minitouch_bench.regression.gate import Decision, GateResult
from minitouch_bench.regression.tables import (
    changes_table,
    comparison_lines,
    comparison_notes,
    comparison_tables,
    episodes_line,
    gate_notes,
    gate_table,
    result_line,
    run_line,
)
from minitouch_bench.rendering.markdown import code_span, escape, table_lines
from minitouch_bench.reporting.tables import OUTCOME_TITLES

MARKS = {Decision.PASSED: "✅", Decision.REGRESSION: "❌", Decision.INCONCLUSIVE: "❔"}
SUMMARY_CHANGES = 50
"""Changed episodes that a result lists; the JSON has all of them."""


def comparison_markdown(comparison: Comparison) -> str:
    """Write a comparison as a page."""
    parts = ["# Comparison of runs", ""]
    parts += [f"- {escape(run_line(run))}" for run in comparison.runs]
    for one in comparison.pairs:
        titles = (one.first, one.second)
        parts += ["", f"## {titles[1]} against {titles[0]}"]
        for line in comparison_lines(one):
            parts += ["", escape(line)]
        for table in comparison_tables(one):
            parts += ["", f"### {escape(table.title)}", "", *table_lines(table)]
        parts += ["", "### Episodes that ended in another way", ""]
        parts += _changes(one.changes, titles, len(one.changes))
    parts += ["", *(f"- {escape(note)}" for note in comparison_notes(comparison))]
    return "\n".join(parts) + "\n"


def gate_markdown(result: GateResult) -> str:
    """Write a result as a section of a page, such as a GitHub step summary."""
    parts = [f"## {MARKS[result.decision]} minitouch-bench {escape(result_line(result))}", ""]
    parts += [f"- {escape(run_line(run))}" for run in (result.baseline, result.candidate)]
    if line := episodes_line(result):
        parts.append(f"- {escape(line)}")
    parts.append(f"- next: {code_span(result.next_command)}")
    parts += ["", *table_lines(gate_table(result)), ""]
    parts += [f"- {escape(note)}" for note in gate_notes(result)]
    if result.changes:
        title = f"{len(result.changes)} episodes ended in another way"
        titles = (result.baseline.title, result.candidate.title)
        parts += ["", f"<details><summary>{title}</summary>", ""]
        parts += _changes(result.changes, titles, SUMMARY_CHANGES)
        parts += ["", "</details>"]
    return "\n".join(parts) + "\n"


def _changes(changes: Sequence[OutcomeChange], titles: tuple[str, str], most: int) -> list[str]:
    """List the changed episodes; the command stands in a code span, ready to copy."""
    if not changes:
        return ["None."]
    lines = table_lines(changes_table((), titles))
    for change in changes[:most]:
        cells = (
            change.episode,
            OUTCOME_TITLES[change.first],
            OUTCOME_TITLES[change.second],
        )
        command = code_span(change.replays[1]).replace("|", "\\|")
        lines.append(f"| {' | '.join(map(escape, cells))} | {command} |")
    if len(changes) > most:
        lines += ["", f"and {len(changes) - most} more."]
    return lines
