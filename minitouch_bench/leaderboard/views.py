"""The tables of a board: one view a question, drawn alike by Markdown and the site."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from minitouch_bench.leaderboard.board import TOUCH_METRICS, Board, PaperRow, Row
from minitouch_bench.leaderboard.gaps import GAP_TASKS
from minitouch_bench.leaderboard.ranking import RANKED_BY, Rank
from minitouch_bench.leaderboard.scores import MEAN_SUCCESS, OVERALL
from minitouch_bench.metrics import METRICS, ShownIn, direction_of, metrics_shown_in
from minitouch_bench.records import Estimate, Gap
from minitouch_bench.rendering.tables import ABSENT, format_value
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.paper import CAVEAT, PAPER_TASKS, PaperValue

RANKED, CALIBRATION, PAPER = "ranked", "calibration", "paper"
"""Kinds of rows; only the first has ranks."""

NOVEL, TOUCH = "novel-shapes", "touch"
EPISODE_VARIANCE = "episode variance only (one training seed)"


@dataclass(frozen=True)
class Figure:
    """A cell: its text, its interval, how both were made, and what a sort goes by."""

    text: str = ABSENT
    interval: str = ""
    title: str = ""
    key: float | None = None
    share: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Heading:
    """A column: its block, label and unit; ``share`` columns get a gauge from 0 to 1."""

    label: str
    group: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Line:
    """A row of a view. ``row`` is None for the paper's and for a calibration not yet run."""

    kind: str
    name: str
    note: str
    rank: Rank | None
    cells: tuple[Figure, ...]
    row: Row | None = None


@dataclass(frozen=True)
class View:
    """A table: ``lead`` says what it ranks by."""

    key: str
    title: str
    lead: str
    headings: tuple[Heading, ...]
    lines: tuple[Line, ...]


def views(board: Board) -> tuple[View, ...]:
    """Return every table of a board."""
    return (
        _overall(board),
        *(_task(board, task) for task in PAPER_TASKS),
        _novel(board),
        _touch(board),
    )


def figure(metric: str, estimate: Estimate | None) -> Figure:
    """Write an estimate as a cell."""
    if estimate is None:
        return Figure()
    name = "success" if metric == MEAN_SUCCESS else metric
    low, high = format_value(name, estimate.low), format_value(name, estimate.high)
    is_share = METRICS[name].is_share
    counted = "training seeds" if "seeds" in estimate.method else "episodes"
    return Figure(
        text=format_value(name, estimate.value),
        interval=f"[{low}, {high}]",
        title=f"{estimate.count} {counted}, 95 % interval: {estimate.method}",
        key=estimate.value,
        share=(estimate.value, estimate.low, estimate.high) if is_share else None,
    )


def _overall(board: Board) -> View:
    wanted = ((OVERALL, MEAN_SUCCESS), *((task, RANKED_BY[task]) for task in PAPER_TASKS))
    headings = (
        Heading("Mean success", unit="three tasks ↑"),
        *(
            Heading(task_title(task), unit=f"{METRICS[metric].label.lower()} ↑")
            for task, metric in wanted[1:]
        ),
    )
    lead = (
        "Ranked by the mean success over Pushing, Opening and Pick-up. Rows that cannot be told "
        "apart on the same episodes share a rank."
    )
    return _view(board, OVERALL, "Overall", lead, headings, wanted)


def _task(board: Board, task: str) -> View:
    shown = metrics_shown_in(ShownIn.TABLE4, task)
    metrics = [RANKED_BY[task], *(m for m in shown if m != RANKED_BY[task])]
    headings = tuple(
        Heading(
            METRICS[metric].label,
            unit=f"{METRICS[metric].unit} {direction_of(metric, task)}".strip(),
        )
        for metric in metrics
    )
    lead = f"Ranked by {METRICS[RANKED_BY[task]].label.lower()}. The columns of Table 4."
    return _view(board, task, task_title(task), lead, headings, [(task, m) for m in metrics])


def _touch(board: Board) -> View:
    wanted = [(task, metric) for task in PAPER_TASKS for metric in TOUCH_METRICS]
    headings = tuple(
        Heading(METRICS[metric].label, task_title(task), METRICS[metric].unit)
        for task, metric in wanted
    )
    lead = (
        "What the fingers did: the share of episodes with any contact, the contacts begun, and "
        "the time to the first one over the episodes that touched. In the overall order."
    )
    return _view(board, TOUCH, "Touch", lead, headings, wanted, ranked_by=OVERALL)


def _novel(board: Board) -> View:
    headings = tuple(
        Heading(label, f"{task_title(task)}: {METRICS[RANKED_BY[task]].label.lower()}")
        for task in GAP_TASKS
        for label in ("Held-out", "Train", "Gap")
    )
    lead = (
        "200 shapes that training never sees beside 200 that it may see. Gap: held-out minus "
        "train. In the overall order."
    )
    lines = tuple(
        Line(kind, name, note, rank, tuple(_gap_cells(row)), row)
        for kind, name, note, rank, row in _heads(board, OVERALL)
        if kind != PAPER
    )
    return View(NOVEL, "Novel shapes", lead, headings, lines)


def gap_figures(metric: str, gap: Gap) -> tuple[Figure, Figure, Figure]:
    """Write a gap as three cells: held-out, train and the difference with its sign."""
    found = gap.difference
    value, low, high = (
        format(number, f"+z{METRICS[metric].number_format}")
        for number in (found.value, found.low, found.high)
    )
    title = f"95 % interval: {found.method}"
    difference = Figure(value, f"[{low}, {high}]", title, found.value)
    return figure(metric, gap.held_out), figure(metric, gap.train), difference


def _gap_cells(row: Row | None) -> Iterator[Figure]:
    for task in GAP_TASKS:
        gap = row.gaps.get(task) if row else None
        yield from gap_figures(RANKED_BY[task], gap) if gap else (Figure(),) * 3


def _view(  # noqa: PLR0917 - one table
    board: Board,
    key: str,
    title: str,
    lead: str,
    headings: tuple[Heading, ...],
    wanted: Sequence[tuple[str, str]],
    ranked_by: str = "",
) -> View:
    papers = {paper.method: paper for paper in board.paper}
    lines = tuple(
        Line(kind, name, note, rank, _cells(row, papers.get(name), wanted), row)
        for kind, name, note, rank, row in _heads(board, ranked_by or key)
        if kind != PAPER or any(place in papers[name].values for place in wanted)
    )
    return View(key, title, lead, headings, lines)


Head = tuple[str, str, str, Rank | None, Row | None]


def _heads(board: Board, ranked_by: str) -> Iterator[Head]:
    """Walk through the rows in the order of a ranking, with what stands before their cells."""
    metric = MEAN_SUCCESS if ranked_by == OVERALL else RANKED_BY[ranked_by]
    ordered = sorted(
        board.ranked,
        key=lambda row: (
            row.ranks[ranked_by].best,
            -row.figures[ranked_by, metric].value,
            row.entry.name,
        ),
    )
    for row in ordered:
        yield RANKED, row.entry.name, row.entry.about.method, row.ranks[ranked_by], row
    for row in board.calibration:
        yield CALIBRATION, row.entry.name, row.entry.about.method, None, row
    for name in board.missing_calibration:
        yield CALIBRATION, name, "not submitted yet", None, None
    for paper in board.paper:
        yield PAPER, paper.method, CAVEAT, None, None


def _cells(
    row: Row | None, paper: PaperRow | None, wanted: Sequence[tuple[str, str]]
) -> tuple[Figure, ...]:
    if paper is not None:
        return tuple(_printed(paper.values.get(place)) for place in wanted)
    return tuple(
        figure(metric, row.estimate(task, metric) if row else None) for task, metric in wanted
    )


def _printed(value: PaperValue | None) -> Figure:
    if value is None:
        return Figure()
    return Figure(value.text, value.remark, "as printed in the paper", value.number)
