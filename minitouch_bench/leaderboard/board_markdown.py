"""``leaderboard.md``: the tables of a board in GitHub's Markdown."""

from collections.abc import Sequence

from minitouch_bench.leaderboard.board import Board
from minitouch_bench.leaderboard.validation import Verdict
from minitouch_bench.leaderboard.views import (
    CALIBRATION,
    EPISODE_VARIANCE,
    PAPER,
    Line,
    View,
    views,
)
from minitouch_bench.rendering.markdown import escape
from minitouch_bench.rendering.tables import ABSENT
from minitouch_bench.reporting.paper import CAVEAT, CITATION, PAPER_METHODS

SHOWN_REASONS = 3


def board_markdown(board: Board) -> str:
    """Write a board as Markdown."""
    parts = [
        "# MiniTouch leaderboard",
        "",
        f"Protocol {escape(board.protocol)}, `{board.protocol_digest}`.",
    ]
    for view in views(board):
        parts += ["", f"## {view.title}", "", escape(view.lead), "", *_table(view)]
    parts += ["", "## Submissions", "", *_about(board)]
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
        "Calibration rows are the built-in policies: scripted reads the simulator's state and is "
        "the ceiling, random and zero are the floor. They are never ranked.",
        f"{', '.join(PAPER_METHODS)}: the paper's own figures, {CAVEAT} ({CITATION}). They are "
        "never ranked.",
    )


def _table(view: View) -> list[str]:
    heads = [
        "<br>".join(escape(part) for part in (column.group, column.label, column.unit) if part)
        for column in view.headings
    ]
    lines = [
        _line(["Rank", "Submission", *heads]),
        _line(["---:", "---", *["---:"] * len(heads)]),
    ]
    return lines + [_row(line) for line in view.lines]


def _row(line: Line) -> str:
    name = escape(line.name) + {CALIBRATION: " (calibration)", PAPER: " (paper)"}.get(line.kind, "")
    rank = ABSENT
    if line.rank is not None:
        best, worst = line.rank.best, line.rank.worst
        rank = f"{best} ({best} to {worst})" if worst > best else str(best)
    cells = [escape(f"{cell.text} {cell.interval}".strip()) for cell in line.cells]
    return _line([rank, name, *cells])


def _about(board: Board) -> list[str]:
    heads = ("Submission", "Method", "Proof", "Modalities", "Training steps", "Training seeds")
    lines = [_line(heads), _line(["---", "---", "---", "---", "---:", "---:"])]
    for row in board.rows:
        about = row.entry.about
        cells = (
            about.name,
            about.method,
            row.entry.level.value,
            ", ".join(about.modalities) or "none",
            str(about.training_steps),
            str(len(row.entry.seeds)),
        )
        lines.append(_line([escape(cell) for cell in cells]))
    return lines


def _left_out(title: str, verdicts: Sequence[Verdict]) -> list[str]:
    if not verdicts:
        return []
    lines = ["", f"## {title}", ""]
    for verdict in verdicts:
        lines.append(f"- **{escape(verdict.directory.name)}**")
        lines += [f"  - {escape(str(fault))}" for fault in verdict.faults[:SHOWN_REASONS]]
        if (more := len(verdict.faults) - SHOWN_REASONS) > 0:
            lines.append(f"  - and {more} more")
    return lines


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
