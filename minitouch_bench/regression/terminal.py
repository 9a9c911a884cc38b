"""Comparisons and results of the gate on a terminal."""

from collections.abc import Sequence

from rich.console import Console, Group, RenderableType
from rich.text import Text

from minitouch_bench.regression.comparison import Comparison, OutcomeChange
from minitouch_bench.regression.gate import Decision, GateResult
from minitouch_bench.regression.tables import (
    changes_table,
    comparison_lines,
    comparison_notes,
    comparison_tables,
    episodes_line,
    gate_notes,
    gate_tables,
    next_line,
    result_line,
    run_line,
)
from minitouch_bench.reporting.terminal import draw_table

SHOWN_CHANGES = 20
"""Changed episodes on a screen; the files have all of them."""

STYLES = {
    Decision.PASSED: "bold green",
    Decision.REGRESSION: "bold red",
    Decision.INCONCLUSIVE: "bold",
}


def show_comparison(comparison: Comparison, console: Console) -> None:
    """Print a comparison; text is never read as markup."""
    parts: list[RenderableType] = [Text(run_line(run)) for run in comparison.runs]
    for one in comparison.pairs:
        title = f"{one.second} against {one.first}"
        parts += [Text(), Text(title, style="bold underline")]
        parts += [Text(line) for line in comparison_lines(one)]
        parts += [draw_table(table) for table in comparison_tables(one)]
        parts += _changes(one.changes, (one.first, one.second))
    parts += [Text(), *(Text(note, style="dim") for note in comparison_notes(comparison))]
    console.print(Group(*parts))


def show_result(result: GateResult, console: Console) -> None:
    """Print a gate's result; the last two lines are PASS or FAIL, and what to type next."""
    titles = (result.baseline.title, result.candidate.title)
    parts: list[RenderableType] = [
        Text(run_line(result.baseline)),
        Text(run_line(result.candidate)),
        Text(),
        *(draw_table(table) for table in gate_tables(result)),
        *_changes(result.changes, titles),
        Text(),
        *(Text(note, style="dim") for note in gate_notes(result)),
        Text(),
    ]
    console.print(Group(*parts))
    if line := episodes_line(result):
        console.print(Text(line), soft_wrap=True)
    console.print(Text(result_line(result), style=STYLES[result.decision]), soft_wrap=True)
    console.print(Text(next_line(result)), soft_wrap=True)


def _changes(changes: Sequence[OutcomeChange], titles: tuple[str, str]) -> list[RenderableType]:
    if not changes:
        return []
    more = len(changes) - SHOWN_CHANGES
    parts: list[RenderableType] = [
        Text(),
        draw_table(changes_table(changes[:SHOWN_CHANGES], titles)),
    ]
    if more > 0:
        parts.append(Text(f"and {more} more; --json has all of them", style="dim"))
    return parts
