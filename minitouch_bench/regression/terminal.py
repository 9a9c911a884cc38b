"""Comparisons and verdicts on a terminal."""

from collections.abc import Sequence

from rich.console import Console, Group, RenderableType
from rich.text import Text

from minitouch_bench.regression.comparison import Change, Comparison
from minitouch_bench.regression.gate import Ruling, Verdict
from minitouch_bench.regression.tables import changes_table, comparison_tables, verdict_tables
from minitouch_bench.regression.wording import (
    comparison_notes,
    effort_line,
    entrant_line,
    headline,
    side_line,
    verdict_notes,
    versus_lines,
)
from minitouch_bench.rendering.terminal import draw_table

SHOWN_CHANGES = 20
"""Changed episodes on a screen; the files have all of them."""

STYLES = {Ruling.PASSED: "bold green", Ruling.REGRESSION: "bold red", Ruling.INCONCLUSIVE: "bold"}


def show_comparison(comparison: Comparison, console: Console) -> None:
    """Print a comparison; text is never read as markup."""
    parts: list[RenderableType] = [Text(entrant_line(one)) for one in comparison.entrants]
    for versus in comparison.pairs:
        names = (versus.first.letter, versus.second.letter)
        parts += [Text(), Text(f"{names[1]} against {names[0]}", style="bold underline")]
        parts += [Text(line) for line in versus_lines(versus)]
        parts += [draw_table(table) for table in comparison_tables(versus)]
        parts += _changes(versus.changes, names)
    parts += [Text(), *(Text(note, style="dim") for note in comparison_notes(comparison))]
    console.print(Group(*parts))


def show_verdict(verdict: Verdict, console: Console) -> None:
    """Print a gate's verdict."""
    parts: list[RenderableType] = [
        Text(side_line("Baseline", verdict.baseline)),
        Text(side_line("Candidate", verdict.candidate)),
        Text(),
        *(draw_table(table) for table in verdict_tables(verdict)),
        *_changes(verdict.changes, ("baseline", "candidate")),
        Text(),
        *(Text(note, style="dim") for note in verdict_notes(verdict)),
        Text(),
    ]
    if verdict.effort is not None:
        parts.append(Text(effort_line(verdict)))
    parts.append(Text(headline(verdict), style=STYLES[verdict.ruling]))
    console.print(Group(*parts))


def _changes(changes: Sequence[Change], names: tuple[str, str]) -> list[RenderableType]:
    if not changes:
        return []
    more = len(changes) - SHOWN_CHANGES
    parts: list[RenderableType] = [
        Text(),
        draw_table(changes_table(changes[:SHOWN_CHANGES], names)),
    ]
    if more > 0:
        parts.append(Text(f"and {more} more; --json has all of them", style="dim"))
    return parts
