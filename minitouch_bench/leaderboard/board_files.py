"""``leaderboard.md`` and ``leaderboard.csv``: the tables of a board as text.

``leaderboard.json`` is the board itself.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from minitouch_bench.leaderboard.board import CEILING, FLOORS, Board, BoardRow, LeftOut
from minitouch_bench.leaderboard.scores import RANKED_BY
from minitouch_bench.leaderboard.views import (
    CALIBRATION,
    EPISODE_VARIANCE,
    PAPER,
    RANKED,
    UNRANKED,
    View,
)
from minitouch_bench.protocol.minitouch import MAIN_SUITE, NOVEL_SHAPES
from minitouch_bench.records import Estimate
from minitouch_bench.rendering.markdown import escape, table_lines
from minitouch_bench.rendering.tables import ABSENT, Cell, Column, Row, Table
from minitouch_bench.reporting.frames import Row as CsvRow
from minitouch_bench.reporting.frames import csv_text, make_frame
from minitouch_bench.reporting.labels import listed
from minitouch_bench.reporting.paper import PAPER_METHODS, PAPER_NOTE, paper_values

SHOWN_REASONS = 3


@dataclass(frozen=True)
class Fact:
    """What a board tells of a row beside its figures: a column of its CSV and of its Markdown."""

    name: str
    label: str
    of: Callable[[BoardRow], str | int | tuple[str, ...]]
    is_text: bool = True


FACTS = (
    Fact("method", "Method", lambda row: row.method),
    Fact("proof", "Proof", lambda row: row.proof.value),
    Fact("modalities", "Modalities", lambda row: row.modalities),
    Fact("training_steps", "Training steps", lambda row: row.training_steps, is_text=False),
    Fact("training_seeds", "Training seeds", lambda row: len(row.training_seeds), is_text=False),
    Fact("repeats", "Repeats", lambda row: row.repeats),
)

COLUMNS = (
    "name", "kind", *(fact.name for fact in FACTS), "suite", "task", "metric",
    "value", "low", "high", "count", "interval", "rank", "worst_rank",
)  # fmt: skip
"""Those of ``leaderboard.csv``, which has a row per value."""

GAP = "held-out minus train"


def board_markdown(board: Board, tables: Sequence[View]) -> str:
    """Write a board and its tables as GitHub's Markdown."""
    parts = [
        "# MiniTouch leaderboard",
        "",
        f"Protocol {escape(board.protocol)}, `{board.protocol_digest}`.",
    ]
    for view in tables:
        parts += ["", f"## {view.title}", "", escape(view.lead), "", *table_lines(view.table())]
    parts += ["", "## Submissions", "", *table_lines(_about(board))]
    parts += _left_out("Other protocols, not ranked", board.other_protocol)
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


def _left_out(title: str, refusals: Sequence[LeftOut]) -> list[str]:
    if not refusals:
        return []
    lines = ["", f"## {title}", ""]
    for refusal in refusals:
        lines.append(f"- **{escape(refusal.name)}**")
        lines += [f"  - {escape(reason)}" for reason in refusal.reasons[:SHOWN_REASONS]]
        if (more := len(refusal.reasons) - SHOWN_REASONS) > 0:
            lines.append(f"  - and {more} more")
    return lines


def board_csv(board: Board) -> str:
    """Write every figure of a board; those that do not exist have no row."""
    rows: list[CsvRow] = []
    for row in board.rows:
        head = _head(row)
        rows += [(*head, *rest) for rest in _figures(row)]
    for method in PAPER_METHODS:
        head = (method, PAPER, *[None] * len(FACTS))
        for (task, metric), printed in paper_values(method).items():
            value = (float(printed.text), None, None, None, printed.remark)
            rows.append((*head, "", task, metric, *value, None, None))
    return csv_text(make_frame(COLUMNS, rows))


def _head(row: BoardRow) -> CsvRow:
    kind = CALIBRATION if row.is_calibration else RANKED if row.is_ranked else UNRANKED
    told = (fact.of(row) for fact in FACTS)
    return row.name, kind, *(" ".join(one) if isinstance(one, tuple) else one for one in told)


def _figures(row: BoardRow) -> Iterator[CsvRow]:
    """Walk through a row's estimates, from the suite's name on."""
    for task, figures in row.figures.items():
        for metric, found in figures.items():
            rank = row.ranks.get(task) if metric == RANKED_BY[task] else None
            ranks = (rank.best, rank.worst) if rank else (None, None)
            yield MAIN_SUITE, task, metric, *_interval(found), *ranks
    for task, gap in row.novel_shapes.items():
        for split, found in (
            ("held-out", gap.held_out),
            ("train", gap.train),
            (GAP, gap.difference),
        ):
            metric = f"{RANKED_BY[task]}, {split}"
            yield NOVEL_SHAPES, task, metric, *_interval(found), None, None


def _interval(found: Estimate) -> CsvRow:
    return found.value, found.low, found.high, found.count, found.method
