"""The tables of a board: one view per question, drawn alike by Markdown and the site."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from minitouch_bench.leaderboard.board import TOUCH_METRICS, Board, BoardRow, in_order
from minitouch_bench.leaderboard.ranking import GAP_TASKS, MEAN_SUCCESS, OVERALL, RANKED_BY, Rank
from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS
from minitouch_bench.metrics.definitions import METRICS, ShownIn, metrics_shown_in
from minitouch_bench.reporting import tables
from minitouch_bench.reporting.labels import CAVEAT, PAPER_METHODS, listed, paper_cell, task_title
from minitouch_bench.reporting.run_tables import gap_cells

RANKED, UNRANKED, CALIBRATION, PAPER = "ranked", "unranked", "calibration", "paper"
"""Kinds of rows; only the first has ranks."""

NOVEL, TOUCH = "novel-shapes", "touch"
EPISODE_VARIANCE = "episode variance only (one training seed)"
SEED_VARIANCE = (
    "Student's t over training seeds, no narrower than over all their episodes. It contains the "
    "true mean in about 95 % if the seeds' values are about normal; if some seeds fail, in 42 to "
    "94 % with five seeds."
)


@dataclass(frozen=True)
class BoardLine:
    """A line of a view; ``row`` is None for the paper's and for a calibration not yet run."""

    kind: str
    name: str
    note: str
    rank: Rank | None
    row: BoardRow | None
    cells: tuple[tables.Cell, ...] = ()


@dataclass(frozen=True)
class BoardView:
    """A table: ``lead`` says what it ranks by."""

    key: str
    title: str
    lead: str
    columns: tuple[tables.Column, ...]
    lines: tuple[BoardLine, ...]

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """The blocks of columns in order, each with its number of columns."""
        return tables.column_groups(self.columns)

    @property
    def edges(self) -> frozenset[int]:
        """The columns that begin a block; none where there are no blocks."""
        names = ["", *(column.group for column in self.columns)]
        return frozenset(i for i, name in enumerate(names[1:]) if name and name != names[i])

    def table(self) -> tables.Table:
        """Return the view as a plain table, the kind of a row behind its name."""
        rows = (
            tables.Row((_rank_text(line.rank), _kind_text(line)), line.cells) for line in self.lines
        )
        return tables.Table(self.title, ("Rank", "Submission"), self.columns, tuple(rows))


def views(board: Board) -> tuple[BoardView, ...]:
    """Return every table of a board."""
    return (
        _overall(board),
        *(_task(board, task) for task in BOARD_TASKS),
        _novel(board),
        _touch(board),
    )


def _overall(board: Board) -> BoardView:
    goals = [task_title(task) for task in BOARD_GOALS]
    columns = (
        tables.Column("Mean success", unit=f"{len(goals)} tasks ↑"),
        *(tables.Column(task_title(task), unit=f"{_label(task)} ↑") for task in BOARD_TASKS),
    )
    lead = f"Ordered by the mean success over {listed(goals)}."
    return BoardView(
        OVERALL, "Overall", lead, columns, _lines(board, OVERALL, [*RANKED_BY.items()])
    )


def _task(board: Board, task: str) -> BoardView:
    ranked_by = RANKED_BY[task]
    metrics = dict.fromkeys((ranked_by, *metrics_shown_in(ShownIn.TABLE4, task)))
    columns = tuple(
        tables.Column(
            METRICS[m].label, unit=f"{METRICS[m].unit} {METRICS[m].direction_in(task)}".strip()
        )
        for m in metrics
    )
    lead = f"Ordered by {_label(task)}. The columns of Table 4."
    lines = _lines(board, task, [(task, metric) for metric in metrics])
    return BoardView(task, task_title(task), lead, columns, lines)


def _touch(board: Board) -> BoardView:
    wanted = [(task, metric) for task in BOARD_TASKS for metric in TOUCH_METRICS]
    columns = tuple(
        tables.Column(METRICS[metric].label, task_title(task), METRICS[metric].unit)
        for task, metric in wanted
    )
    meanings = (f"{METRICS[name].label}: {METRICS[name].meaning}." for name in TOUCH_METRICS)
    lead = " ".join(("What the fingers did, in the overall order.", *meanings))
    return BoardView(TOUCH, "Touch", lead, columns, _lines(board, OVERALL, wanted))


def _novel(board: Board) -> BoardView:
    columns = tuple(
        tables.Column(label, f"{task_title(task)}: {_label(task)}")
        for task in GAP_TASKS
        for label in ("Held-out", "Train", "Gap")
    )
    lead = (
        "Shapes that training never sees beside as many that it may see. Gap: held-out minus "
        "train. In the overall order."
    )
    lines = tuple(replace(line, cells=tuple(_gap_cells(line.row))) for line in _heads(board))
    return BoardView(NOVEL, "Novel shapes", lead, columns, lines)


def _gap_cells(row: BoardRow | None) -> Iterator[tables.Cell]:
    for task in GAP_TASKS:
        gap = row.novel_shapes.get(task) if row else None
        held_out, train, difference, _ = gap_cells(task, RANKED_BY[task], gap)
        yield from (with_learned(held_out, row, task), train, difference)


def _lines(board: Board, key: str, wanted: Sequence[tuple[str, str]]) -> tuple[BoardLine, ...]:
    """Return the lines with the ``wanted`` metrics by rank, then the paper's with a value."""
    lines = [
        replace(line, cells=tuple(_cell(line.row, *names) for names in wanted))
        for line in _heads(board, key)
    ]
    for method in PAPER_METHODS:
        cells = tuple(paper_cell(*names, method) for names in wanted)
        if any(cell.text != tables.ABSENT for cell in cells):
            lines.append(BoardLine(PAPER, method, CAVEAT, None, None, cells))
    return tuple(lines)


def _cell(row: BoardRow | None, task: str, metric: str) -> tables.Cell:
    estimate = row.estimate(task, metric) if row else None
    cell = tables.estimate_cell("success" if metric == MEAN_SUCCESS else metric, estimate)
    is_first = metric in (RANKED_BY[task], TOUCH_METRICS[0])  # of the row's cells of the task
    return with_learned(cell, row, task) if is_first else cell


def with_learned(cell: tables.Cell, row: BoardRow | None, task: str) -> tables.Cell:
    """Write beside a value how many of the row's training seeds learned the task."""
    learned = row.learned_in(task) if row and cell.text != tables.ABSENT else ""
    return replace(cell, small=f"{cell.small}, {learned}") if learned else cell


def _heads(board: Board, key: str = OVERALL) -> Iterator[BoardLine]:
    """Walk through the rows' lines without their cells, in the order of a ranking."""
    groups = (
        (RANKED, in_order(board.ranked, key)),
        (UNRANKED, in_order(board.unranked, key)),
        (CALIBRATION, board.calibration),
    )
    for kind, rows in groups:
        for row in rows:
            yield BoardLine(kind, row.name, row.method, row.ranks.get(key), row)
    for name in board.missing_calibration:
        yield BoardLine(CALIBRATION, name, "not submitted yet", None, None)


def _label(task: str) -> str:
    return METRICS[RANKED_BY[task]].label.lower()


def _rank_text(rank: Rank | None) -> str:
    if rank is None:
        return tables.ABSENT
    return f"{rank.best}" + (f" ({rank.best} to {rank.worst})" if rank.worst > rank.best else "")


def _kind_text(line: BoardLine) -> str:
    return line.name if line.kind == RANKED else f"{line.name} ({line.kind})"
