"""``leaderboard.csv``: one row per value, in long form."""

from minitouch_bench.leaderboard.board import FACTS, Board, BoardRow
from minitouch_bench.leaderboard.scores import MEAN_SUCCESS, NOVEL_SHAPES, OVERALL, RANKED_BY
from minitouch_bench.leaderboard.submission import MAIN_SUITE
from minitouch_bench.leaderboard.views import CALIBRATION, PAPER, RANKED, UNRANKED
from minitouch_bench.reporting.frames import Row, csv_text, make_frame
from minitouch_bench.reporting.paper import PAPER_METHODS, paper_values

COLUMNS = (
    "name",
    "kind",
    *(fact.name for fact in FACTS),
    "suite",
    "task",
    "metric",
    "value",
    "low",
    "high",
    "count",
    "interval",
    "rank",
    "worst_rank",
)
GAP = "held-out minus train"


def board_csv(board: Board) -> str:
    """Write every figure of a board; those that do not exist have no row."""
    rows: list[Row] = []
    for row in board.rows:
        rows += _figures(row)
        rows += _gaps(row)
    for method in PAPER_METHODS:
        head: Row = (method, PAPER, *[None] * len(FACTS))
        for (task, metric), printed in paper_values(method).items():
            value, none = float(printed.text), (None,) * 3
            rows.append((*head, "", task, metric, value, *none, printed.remark, None, None))
    return csv_text(make_frame(COLUMNS, rows))


def _head(row: BoardRow) -> Row:
    kind = CALIBRATION if row.scored.is_calibration else RANKED if row.ranks else UNRANKED
    told = (fact.of(row) for fact in FACTS)
    return row.name, kind, *(" ".join(one) if isinstance(one, tuple) else one for one in told)


def _figures(row: BoardRow) -> list[Row]:
    rows: list[Row] = []
    head = _head(row)
    for task, figures in row.scored.figures.items():
        for metric, found in figures.items():
            is_ranked = metric == (MEAN_SUCCESS if task == OVERALL else RANKED_BY[task])
            rank = row.ranks.get(task) if is_ranked else None
            ranks = (rank.best, rank.worst) if rank else (None, None)
            interval = (found.value, found.low, found.high, found.count, found.method)
            rows.append((*head, MAIN_SUITE, task, metric, *interval, *ranks))
    return rows


def _gaps(row: BoardRow) -> list[Row]:
    rows: list[Row] = []
    for task, gap in row.scored.gaps.items():
        splits = (("held-out", gap.held_out), ("train", gap.train), (GAP, gap.difference))
        for split, found in splits:
            interval = (found.value, found.low, found.high, found.count, found.method)
            metric = f"{RANKED_BY[task]}, {split}"
            rows.append((*_head(row), NOVEL_SHAPES, task, metric, *interval, None, None))
    return rows
