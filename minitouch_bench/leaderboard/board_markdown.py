"""``leaderboard.md``: the tables of a board in GitHub's Markdown."""

from collections.abc import Sequence

from minitouch_bench.leaderboard.board import CEILING, FACTS, FLOORS, Board
from minitouch_bench.leaderboard.scores import Refusal
from minitouch_bench.leaderboard.views import EPISODE_VARIANCE, View
from minitouch_bench.rendering.markdown import escape, table_lines
from minitouch_bench.rendering.tables import ABSENT, Cell, Column, Row, Table
from minitouch_bench.reporting.labels import listed
from minitouch_bench.reporting.paper import PAPER_NOTE

SHOWN_REASONS = 3


def board_markdown(board: Board, tables: Sequence[View]) -> str:
    """Write a board and its tables as Markdown."""
    parts = [
        "# MiniTouch leaderboard",
        "",
        f"Protocol {escape(board.protocol)}, `{board.protocol_digest}`.",
    ]
    for view in tables:
        parts += ["", f"## {view.title}", "", escape(view.lead), "", *table_lines(view.table())]
    parts += ["", "## Submissions", "", *table_lines(_about(board))]
    parts += _left_out("Other protocols, not ranked", board.apart)
    parts += _left_out("Left out", board.refused)
    parts += ["", *(f"- {escape(note)}" for note in notes())]
    return "\n".join(parts) + "\n"


def notes() -> tuple[str, ...]:
    """Return what must be said below every table."""
    return (
        "A rank is 1 + the rows that are better beyond doubt; the range behind it holds the true "
        "rank with 95 % confidence.",
        "Brackets: 95 % interval. One training seed: Wilson for shares, bootstrap over episodes "
        f"for means; {EPISODE_VARIANCE}. Several: bootstrap over training seeds.",
        f"Calibration rows are the built-in policies: {CEILING} reads the simulator's state and is "
        f"the ceiling, {listed(FLOORS)} are floors. They are never ranked.",
        f"{PAPER_NOTE} They are never ranked.",
    )


def _about(board: Board) -> Table:
    rows = tuple(
        Row((row.name,), tuple(_cell(fact.of(row)) for fact in FACTS)) for row in board.rows
    )
    columns = tuple(Column(one.label, is_text=one.is_text) for one in FACTS)
    return Table("Submissions", ("Submission",), columns, rows)


def _cell(told: str | int | tuple[str, ...]) -> Cell:
    if isinstance(told, tuple):
        return Cell(", ".join(told) or "none")
    return Cell(str(told) or ABSENT)


def _left_out(title: str, refusals: Sequence[Refusal]) -> list[str]:
    if not refusals:
        return []
    lines = ["", f"## {title}", ""]
    for refusal in refusals:
        lines.append(f"- **{escape(refusal.name)}**")
        lines += [f"  - {escape(reason)}" for reason in refusal.reasons[:SHOWN_REASONS]]
        if (more := len(refusal.reasons) - SHOWN_REASONS) > 0:
            lines.append(f"  - and {more} more")
    return lines
