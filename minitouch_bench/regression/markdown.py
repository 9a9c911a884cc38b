"""Comparisons and verdicts as GitHub's Markdown."""

from collections.abc import Sequence

from minitouch_bench.regression.comparison import Change, Comparison
from minitouch_bench.regression.gate import Ruling, Verdict
from minitouch_bench.regression.tables import changes_table, comparison_tables, verdict_table
from minitouch_bench.regression.wording import (
    comparison_notes,
    effort_line,
    entrant_line,
    headline,
    side_line,
    verdict_notes,
    versus_lines,
)
from minitouch_bench.rendering.markdown import code_span, escape, table_lines
from minitouch_bench.reporting.tables import OUTCOME_TITLES

MARKS = {Ruling.PASSED: "✅", Ruling.REGRESSION: "❌", Ruling.INCONCLUSIVE: "❔"}
SUMMARY_CHANGES = 50
"""Changed episodes that a verdict lists; the JSON has all of them."""


def comparison_markdown(comparison: Comparison) -> str:
    """Write a comparison as a page."""
    parts = ["# Comparison of runs", ""]
    parts += [f"- {escape(entrant_line(entrant))}" for entrant in comparison.entrants]
    for versus in comparison.pairs:
        names = (versus.first.letter, versus.second.letter)
        parts += ["", f"## {names[1]} against {names[0]}"]
        for line in versus_lines(versus):
            parts += ["", escape(line)]
        for table in comparison_tables(versus):
            parts += ["", f"### {escape(table.title)}", "", *table_lines(table)]
        parts += ["", "### Episodes that ended in another way", ""]
        parts += _changes(versus.changes, names, len(versus.changes))
    parts += ["", *(f"- {escape(note)}" for note in comparison_notes(comparison))]
    return "\n".join(parts) + "\n"


def verdict_markdown(verdict: Verdict) -> str:
    """Write a verdict as a section of a page, such as a GitHub step summary."""
    parts = [f"## {MARKS[verdict.ruling]} minitouch-bench: {escape(headline(verdict))}", ""]
    parts += [
        f"- {escape(side_line('Baseline', verdict.baseline))}",
        f"- {escape(side_line('Candidate', verdict.candidate))}",
    ]
    if verdict.effort is not None:
        parts.append(f"- {escape(effort_line(verdict))}")
    parts += ["", *table_lines(verdict_table(verdict)), ""]
    parts += [f"- {escape(note)}" for note in verdict_notes(verdict)]
    if verdict.changes:
        title = f"{len(verdict.changes)} episodes ended in another way"
        parts += ["", f"<details><summary>{title}</summary>", ""]
        parts += _changes(verdict.changes, ("baseline", "candidate"), SUMMARY_CHANGES)
        parts += ["", "</details>"]
    return "\n".join(parts) + "\n"


def _changes(changes: Sequence[Change], names: tuple[str, str], most: int) -> list[str]:
    """List the changed episodes; the command stands in a code span, ready to copy."""
    if not changes:
        return ["None."]
    heads = changes_table((), names)
    lines = table_lines(heads)
    for change in changes[:most]:
        cells = (
            change.key,
            OUTCOME_TITLES[change.first],
            OUTCOME_TITLES[change.second],
        )
        command = code_span(change.replays[1]).replace("|", "\\|")
        lines.append(f"| {' | '.join(map(escape, cells))} | {command} |")
    if len(changes) > most:
        lines += ["", f"and {len(changes) - most} more."]
    return lines
