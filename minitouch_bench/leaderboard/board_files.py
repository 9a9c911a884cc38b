"""``leaderboard.md`` and ``leaderboard.csv``: the tables of a board as text.

``leaderboard.json`` is the board itself.
"""

from collections.abc import Iterator, Sequence
from dataclasses import astuple
from typing import Any

from minitouch_bench.leaderboard.board import (
    CEILING,
    COLUMN_SPECS,
    FLOORS,
    Board,
    BoardRow,
    LeftOut,
)
from minitouch_bench.leaderboard.ranking import BOARD_METRICS, FLOOR_SUCCESS, RANKED_BY
from minitouch_bench.leaderboard.views import (
    CALIBRATION,
    EPISODE_VARIANCE,
    PAPER,
    RANKED,
    SEED_VARIANCE,
    UNRANKED,
    BoardView,
)
from minitouch_bench.metrics.definitions import intervals_in_words
from minitouch_bench.metrics.summary import GAP_PARTS
from minitouch_bench.protocol.minitouch import MAIN_SUITE, NOVEL_SHAPES
from minitouch_bench.reporting.formats import escape_md, table_lines
from minitouch_bench.reporting.frames import CsvRow, rows_csv
from minitouch_bench.reporting.labels import (
    PAPER_METHODS,
    PAPER_NOTE,
    listed,
    paper_values,
    task_title,
)
from minitouch_bench.reporting.tables import Column, Table, make_row

SHOWN_REASONS = 3


TABLE_COLUMNS = {name: column for name, column in COLUMN_SPECS.items() if column.place != "page"}

COLUMNS = (
    "name", "kind", *TABLE_COLUMNS, "suite", "task", "metric",
    "value", "low", "high", "count", "interval", "rank", "worst_rank", "learned_seeds",
)  # fmt: skip
"""Those of ``leaderboard.csv``, which has a row per value."""


def board_markdown(board: Board, tables: Sequence[BoardView]) -> str:
    """Write a board and its tables as GitHub's Markdown."""
    parts = [
        "# MiniTouch leaderboard",
        "",
        f"Protocol {escape_md(board.protocol)}, `{board.protocol_digest}`.",
    ]
    for view in tables:
        parts += [
            "",
            f"## {view.title}",
            "",
            escape_md(view.lead),
            "",
            *table_lines(view.table()),
        ]
    parts += ["", "## Submissions", "", *table_lines(_about(board))]
    parts += _left_out("Other protocols, not ranked", board.other_protocol)
    parts += _left_out("Left out", board.refused)
    parts += ["", *(f"- {escape_md(note)}" for note in notes())]
    return "\n".join(parts) + "\n"


def notes() -> tuple[str, ...]:
    """Return what must be said below every table."""
    return (
        "A rank is 1 + the number of rows that are significantly better; its range ends before "
        "the rows that are significantly worse. All pairs of rows of a table are tested together "
        "at 5 % (Holm). A row of several training seeds is compared as a method, a row of one as "
        "a checkpoint. Where a method fails in some seeds, the tests err more often than 5 %.",
        f"Brackets: 95 % interval. One training seed: {intervals_in_words(BOARD_METRICS)}; "
        f"{EPISODE_VARIANCE}. Several: {SEED_VARIANCE}",
        f"Learned: the lower end of a training seed's interval of success is above {_floors()}, "
        f"the best of {listed(FLOORS)}.",
        f"Calibration rows are the built-in policies: {CEILING} reads the simulator's state and "
        f"solves each task, {listed(FLOORS)} are floors. They are never ranked.",
        f"{PAPER_NOTE} They are never ranked.",
    )


def _floors() -> str:
    return listed([f"{value:.2f} in {task_title(task)}" for task, value in FLOOR_SUCCESS.items()])


def _about(board: Board) -> Table:
    rows = tuple(
        make_row(
            row.name, *(column.write(getattr(row, name)) for name, column in TABLE_COLUMNS.items())
        )
        for row in board.rows
    )
    columns = tuple(
        Column(spec.label, unit=spec.unit, is_text=spec.is_text) for spec in TABLE_COLUMNS.values()
    )
    return Table("Submissions", ("Submission",), columns, rows)


def _left_out(title: str, refusals: Sequence[LeftOut]) -> list[str]:
    if not refusals:
        return []
    lines = ["", f"## {title}", ""]
    for refusal in refusals:
        lines.append(f"- **{escape_md(refusal.name)}**")
        lines += [f"  - {escape_md(reason)}" for reason in refusal.reasons[:SHOWN_REASONS]]
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
        head = (method, PAPER, *[None] * len(TABLE_COLUMNS))
        for (task, metric), printed in paper_values(method).items():
            value = (float(printed.text), None, None, None, printed.remark)
            rows.append((*head, "", task, metric, *value, None, None, None))
    return rows_csv(COLUMNS, rows)


def _head(row: BoardRow) -> CsvRow:
    kind = CALIBRATION if row.is_calibration else RANKED if row.is_ranked else UNRANKED
    values = [getattr(row, name) for name in TABLE_COLUMNS]
    return row.name, kind, *map(_csv_value, values)


def _csv_value(value: Any) -> object:
    """Return a value: of words all, of several numbers how many there are."""
    if not isinstance(value, tuple):
        return value
    return len(value) if value and isinstance(value[0], int) else " ".join(value)


def _figures(row: BoardRow) -> Iterator[CsvRow]:
    """Walk through a row's estimates, from the suite's name on."""
    for task, figures in row.figures.items():
        for metric, estimate in figures.items():
            rank = row.ranks.get(task) if metric == RANKED_BY[task] else None
            ranks = (rank.best, rank.worst) if rank else (None, None)
            learned = row.learned.get(task)
            yield MAIN_SUITE, task, metric, *astuple(estimate), *ranks, learned
    for task, gap in row.novel_shapes.items():
        for part, title in GAP_PARTS.items():
            metric = f"{RANKED_BY[task]}, {title}"
            estimate = getattr(gap, part)
            learned = row.learned.get(task)
            yield NOVEL_SHAPES, task, metric, *astuple(estimate), None, None, learned
