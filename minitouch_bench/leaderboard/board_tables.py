"""The tables of a board: one view per question, and the Markdown file of all of them.

The site draws the same views; ``leaderboard.json`` is the board itself.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from minitouch_bench.leaderboard import ranking
from minitouch_bench.leaderboard.board import (
    CEILING,
    COLUMN_SPECS,
    FLOORS,
    TOUCH_METRICS,
    Board,
    BoardRow,
    in_order,
)
from minitouch_bench.leaderboard.fresh import SIGNIFICANCE
from minitouch_bench.leaderboard.ranking import (
    BOARD_TASKS,
    MEAN_KEYS,
    MEAN_SUCCESS,
    OVERALL,
    RANKED_BY,
    Rank,
    board_key,
)
from minitouch_bench.metrics import definitions
from minitouch_bench.metrics.definitions import METRICS, ShownIn, metrics_shown_in
from minitouch_bench.metrics.statistics import ALPHA, ALPHA_IN_WORDS, MAX_SEEDS
from minitouch_bench.protocol.minitouch import (
    DARK,
    GOAL_TASKS,
    MAIN_SUITE,
    NOVEL_SHAPES,
    PROTOCOL,
)
from minitouch_bench.reporting import labels, tables
from minitouch_bench.reporting.labels import PAPER_METHODS, listed, task_title
from minitouch_bench.reporting.report_tables import gap_cells
from minitouch_bench.reporting.tables import Cell, Column, Table, escape_md

RANKED, UNRANKED, CALIBRATION, PAPER = "ranked", "unranked", "calibration", "paper"
"""Kinds of rows; only the first has ranks."""

EPISODE_VARIANCE = "episode variance only (one training seed)"
SEED_VARIANCE = (
    "Student's t over training seeds, no narrower than over all their episodes. It contains the "
    "true mean in about 95 % if the seeds' values are about normal; if some seeds fail, in 42 to "
    "94 % with five seeds."
)

DARK_LEAD = (
    "The light is off: every picture is black. Pushing is left out, because its target cannot be "
    "felt. "
)


@dataclass(frozen=True)
class BoardLine:
    """A line of a view; ``row`` is None for the paper's.

    ``why``: what decides its rank, "" where it has none.
    """

    kind: str
    name: str
    note: str
    rank: Rank | None
    row: BoardRow | None
    cells: tuple[Cell, ...] = ()
    why: str = ""


@dataclass(frozen=True)
class BoardView:
    """A table: ``lead`` says what it ranks by."""

    key: str
    title: str
    lead: str
    columns: tuple[Column, ...]
    lines: tuple[BoardLine, ...]

    @property
    def edges(self) -> frozenset[int]:
        """The columns that begin a block; none where there are no blocks."""
        names = ["", *(column.group for column in self.columns)]
        return frozenset(i for i, name in enumerate(names[1:]) if name and name != names[i])

    def table(self) -> Table:
        """Return the view as a plain table, the kind of a row behind its name."""
        rows = []
        for line in self.lines:
            name = line.name if line.kind == RANKED else f"{line.name} ({line.kind})"
            rows.append(tables.Row((str(line.rank or tables.ABSENT), name), line.cells))
        return Table(self.title, ("Rank", "Submission"), self.columns, tuple(rows))


def views(board: Board) -> tuple[BoardView, ...]:
    """Return every table of a board that has rows, and those of the main suite in any case."""
    has_dark = any(DARK in row.figures for row in board.rows)
    return (
        _means(board, MAIN_SUITE, "Overall"),
        *(_task(board, task) for task in BOARD_TASKS),
        *([_novel(board)] if any(row.novel_shapes for row in board.rows) else []),
        *([_means(board, DARK, "Dark", DARK_LEAD)] if has_dark else []),
        _touch(board),
    )


def _means(board: Board, suite: str, title: str, before: str = "") -> BoardView:
    """Lay out the mean success of a suite, and what ranks each of its tasks."""
    key = MEAN_KEYS[suite]
    tasks = [task for task in BOARD_TASKS if task in PROTOCOL.suite(suite).tasks]
    goals = [task_title(task) for task in tasks if task in GOAL_TASKS]
    columns = (
        Column("Mean success", unit=f"{len(goals)} tasks ↑"),
        *(Column(task_title(task), unit=f"{_label(task)} ↑") for task in tasks),
    )
    lead = f"{before}Ordered by the mean success over {listed(goals)}."
    keys = (key, *(board_key(suite, task) for task in tasks))
    lines = _lines(board, key, [(key, RANKED_BY[key]) for key in keys])
    return BoardView(key, title, lead, columns, lines)


def _task(board: Board, task: str) -> BoardView:
    names = dict.fromkeys((RANKED_BY[task], *metrics_shown_in(ShownIn.TABLE4, task)))
    metrics = [METRICS[name] for name in names]
    columns = (Column(m.label, unit=f"{m.unit} {m.direction_in(task)}".strip()) for m in metrics)
    lead = f"Ordered by {_label(task)}. The columns of Table 4."
    lines = _lines(board, task, [(task, name) for name in names])
    return BoardView(task, task_title(task), lead, tuple(columns), lines)


def _touch(board: Board) -> BoardView:
    metrics = [METRICS[name] for name in TOUCH_METRICS]
    columns = (Column(m.label, task_title(task), m.unit) for task in BOARD_TASKS for m in metrics)
    meanings = (f"{metric.label}: {metric.meaning}." for metric in metrics)
    bounds = labels.force_note(BOARD_TASKS)
    lead = " ".join(("What the fingers did, in the overall order.", *meanings, bounds))
    wanted = [(task, name) for task in BOARD_TASKS for name in TOUCH_METRICS]
    return BoardView("touch", "Touch", lead, tuple(columns), _lines(board, OVERALL, wanted))


def _novel(board: Board) -> BoardView:
    tasks = PROTOCOL.suite(NOVEL_SHAPES).tasks
    columns = (
        Column(label, f"{task_title(task)}: {_label(task)}")
        for task in tasks
        for label in ("Held-out", "Train", "Gap")
    )
    lead = (
        "Shapes that training never sees beside as many that it may see. Gap: held-out minus "
        "train. In the overall order; ranks are by the held-out shapes of a task."
    )
    lines = (
        replace(line, rank=None, why="", cells=tuple(_gap_cells(line.row, tasks)))
        for line in _heads(board, OVERALL)
        if line.row and line.row.novel_shapes
    )
    return BoardView(NOVEL_SHAPES, "Novel shapes", lead, tuple(columns), tuple(lines))


def _gap_cells(row: BoardRow, tasks: Sequence[str]) -> Iterator[Cell]:
    for task in tasks:
        held_out, train, difference, _ = gap_cells(task, RANKED_BY[task], row.novel_shapes[task])
        if rank := row.ranks.get(board_key(NOVEL_SHAPES, task)):
            held_out = replace(held_out, small=f"{held_out.small}, rank {rank}")
        yield from (held_out, train, difference)


def _lines(board: Board, key: str, wanted: Sequence[tuple[str, str]]) -> tuple[BoardLine, ...]:
    """Return the rows' lines in order with the ``wanted`` metrics, then the paper's lines."""
    lines = [
        replace(line, cells=tuple(_cell(line.row, *names) for names in wanted))
        for line in _heads(board, key)
        if line.row and key in line.row.figures
    ]
    for method in PAPER_METHODS:
        cells = tuple(labels.paper_cell(*names, method) for names in wanted)
        if any(cell.text != tables.ABSENT for cell in cells):
            lines.append(BoardLine(PAPER, method, labels.CAVEAT, None, None, cells))
    return tuple(lines)


def _cell(row: BoardRow, key: str, metric: str) -> Cell:
    name = "success" if metric == MEAN_SUCCESS else metric
    cell = labels.estimate_cell(name, row.estimate(key, metric))
    is_first = metric in (RANKED_BY[key], TOUCH_METRICS[0])  # of the row's cells of the task
    return with_learned(cell, row, key) if is_first else cell


def with_learned(cell: Cell, row: BoardRow, key: str) -> Cell:
    """Write beside a value how many of the row's training seeds learned the task."""
    learned = row.learned_in(key) if cell.text != tables.ABSENT else ""
    return replace(cell, small=f"{cell.small}, {learned}") if learned else cell


def _heads(board: Board, key: str) -> Iterator[BoardLine]:
    """Walk through the rows' lines without their cells, in the order of a ranking."""
    groups = (
        (RANKED, in_order(board.ranked, key)),
        (UNRANKED, in_order(board.unranked, key)),
        (CALIBRATION, in_order(board.calibration, key)),
    )
    for kind, rows in groups:
        for row in rows:
            rank = row.ranks.get(key)
            why = explain_rank(board, row, key) if rank else ""
            note = row.method
            if kind == UNRANKED:
                why = f"No rank: {row.why_no_rank}."
                note += f"; {row.why_no_rank}"
            yield BoardLine(kind, row.name, note, rank, row, why=why)


SHOWN_UNDECIDED = 3
BETTER, WORSE = "Significantly better than", "Significantly worse than"
UNDECIDED = "Not significantly different from"


def explain_rank(board: Board, row: BoardRow, key: str) -> str:
    """Say which rows a ranked row differs from in a table, and which pair is nearly settled."""
    found: dict[str, list[str]] = {BETTER: [], WORSE: [], UNDECIDED: []}
    nearest = ""
    pairs = [pair for pair in board.pairs[key] if row.name in (pair.higher, pair.lower)]
    for pair in sorted(pairs, key=lambda pair: (pair.p, pair.seeds or MAX_SEEDS)):
        verdict, other = (BETTER, pair.lower) if row.name == pair.higher else (WORSE, pair.higher)
        p = f"p = {pair.p:.2g}" if pair.p >= 0.001 else "p < 0.001"
        if not pair.is_significant:
            if pair.seeds and not found[UNDECIDED]:
                nearest = f" About {pair.seeds} training seeds of each would decide between "
                nearest += f"it and {other}."
            verdict = UNDECIDED
        elif pair.p > ALPHA:
            p += ", by a row between"
        found[verdict].append(f"{other} ({p})")
    if len(undecided := found[UNDECIDED]) > SHOWN_UNDECIDED:
        undecided[SHOWN_UNDECIDED:] = [f"{len(undecided) - SHOWN_UNDECIDED} more"]
    said = " ".join(f"{verdict} {listed(rows)}." for verdict, rows in found.items() if rows)
    return f"{said}{nearest}" or "There is no other row."


def _label(task: str) -> str:
    return METRICS[RANKED_BY[task]].label.lower()


# Markdown

TABLE_COLUMNS = {name: column for name, column in COLUMN_SPECS.items() if column.place != "page"}


def board_markdown(board: Board, shown: Sequence[BoardView]) -> str:
    """Write a board and its views as GitHub's Markdown."""
    digest = board.protocol_digest
    parts = ["# MiniTouch leaderboard", "", f"Protocol {escape_md(board.protocol)}, `{digest}`."]
    for view in shown:
        parts += ["", f"## {view.title}", "", escape_md(view.lead), ""]
        parts += [*tables.table_lines(view.table()), ""]
        parts += [_item(one.name, one.why) for one in view.lines if one.why]
    parts += ["", "## Submissions", "", *tables.table_lines(_about(board))]
    for title, refusals in (("Waiting to be played", board.waiting), ("Left out", board.left_out)):
        parts += ["", f"## {title}", ""] if refusals else []
        parts += [_item(one.name, one.reason) for one in refusals]
    parts += ["", *(f"- {escape_md(note)}" for note in board_notes())]
    return "\n".join(parts) + "\n"


def _item(name: str, text: str) -> str:
    return f"- **{escape_md(name)}**: {escape_md(text)}"


def board_notes() -> tuple[str, ...]:
    """Return what must be said below every table."""
    intervals = definitions.intervals_in_words(ranking.BOARD_METRICS)
    floors = [f"{value:.2f} in {task_title(task)}" for task, value in ranking.FLOOR_SUCCESS.items()]
    return (
        "Every row was played on a maintainer's machine from the submission's checkpoints: the "
        "official episodes, and fresh ones whose seeds were drawn afterwards. A row that is "
        f"significantly worse in the fresh ones (one test, at {100 * SIGNIFICANCE:g} %) has no "
        "rank.",
        "A rank is 1 + the number of rows that are significantly better. In a range such as 2 to "
        "4, the second number leaves out the rows that are significantly worse. All pairs of rows "
        f"of a table are tested together at {ALPHA_IN_WORDS} (Holm). A row of several training "
        "seeds is compared as a method, a row of one as a checkpoint. Where a method fails in some "
        "seeds, the tests err more often.",
        "Rows of several trainings are in the order of their values. A row of one training comes "
        "below every row whose interval reaches its value: one training can be a lucky one.",
        "p is corrected for all pairs of the table. With the number of training seeds per row that "
        "is named, the test finds the difference in 4 of 5 repetitions, if the true difference "
        "and the variance between seeds are those seen, the seeds' values are about normal and the "
        "episodes are the same. The number is a guess: a true difference half as large needs four "
        f"times as many. It is left out above {MAX_SEEDS:,}, and for a row of one seed, which does "
        "not show how its seeds vary.",
        f"Brackets: 95 % interval. One training seed: {intervals}; "
        f"{EPISODE_VARIANCE}. Several: {SEED_VARIANCE}",
        "Learned: the lower end of a training seed's interval of success is above "
        f"{listed(floors)}, the best of {listed(FLOORS)}.",
        f"Calibration rows are the built-in policies: {CEILING} reads the simulator's state "
        f"and solves each task, {listed(FLOORS)} are floors. They are never ranked.",
        f"{labels.PAPER_NOTE} They are never ranked. {labels.MARK_NOTE}",
    )


def _about(board: Board) -> Table:
    """Return what each submission says of itself."""
    rows = []
    for row in board.rows:
        texts = (column.write(getattr(row, name)) for name, column in TABLE_COLUMNS.items())
        rows.append(tables.make_row(row.name, *texts))
    columns = (
        Column(spec.label, unit=spec.unit, is_text=spec.is_text) for spec in TABLE_COLUMNS.values()
    )
    return Table("Submissions", ("Submission",), tuple(columns), tuple(rows))
