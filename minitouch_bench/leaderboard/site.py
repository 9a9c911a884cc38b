"""The static site: an index and a page per submission, each complete in itself."""

import html
import math
import shutil
from collections.abc import Collection, Sequence
from pathlib import Path

from markupsafe import Markup

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import os_errors_as, read_file, write_file
from minitouch_bench.leaderboard.board import Board, BoardRow, ScoredSubmission
from minitouch_bench.leaderboard.board_files import notes
from minitouch_bench.leaderboard.inventory import MAX_VIDEO
from minitouch_bench.leaderboard.page import STYLES, TEMPLATES, amount, finish_page, video_address
from minitouch_bench.leaderboard.proof import MEANINGS, ProofLevel
from minitouch_bench.leaderboard.scores import MEAN_SUCCESS, OVERALL
from minitouch_bench.leaderboard.submission import BOARD_TASKS, MODALITIES
from minitouch_bench.leaderboard.views import View
from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL
from minitouch_bench.rendering.charts import Axis, Chart, Dot, Line, Mark, Plot, Tick, share_axis
from minitouch_bench.rendering.pages import PICTURES, render_page
from minitouch_bench.rendering.svg import draw_gauge
from minitouch_bench.rendering.tables import Cell

WIDE, NARROW = 1124, 340
"""Widths of the plot of all submissions, on a desk and on a phone."""

FEW_POINTS = 60
"""Submissions up to which names and intervals are drawn; more would be a wall of lines."""

PAGES = "submission"
"""Directory of the submissions' pages in the site."""


def write_site(
    board: Board,
    tables: Sequence[View],
    scored: Sequence[ScoredSubmission],
    submissions: Path,
    output: Path,
) -> None:
    """Write the index with its tables, the pages, and the pictures and videos they show.

    Pages of submissions that are gone are removed.

    Raises:
        RunDirectoryError: a file cannot be written.
    """
    write_file(output / "index.html", index_html(board, tables))
    pages = output / PAGES
    rows = {row.name: row for row in board.rows}
    for one in scored:
        name = one.row.name
        page = finish_page(one.page, rows[name], len(board.ranked))
        write_file(pages / f"{name}.html", page, durable=False)
        _copy_videos(one.videos, submissions / name, pages)
    _remove_others(pages, rows.keys())
    for task in BOARD_TASKS:
        picture = PICTURES / f"{task}.png"
        if picture.exists():  # a new task may have none yet
            write_file(output / "pictures" / picture.name, picture.read_bytes())


def index_html(board: Board, tables: Sequence[View]) -> str:
    """Write the index."""
    suite = PROTOCOL.suite(MAIN_SUITE)
    return render_page(
        TEMPLATES / "board.html.j2",
        STYLES,
        ("theme.js", "board.js"),
        board=board,
        views=tables,
        levels=list(ProofLevel),
        meanings=MEANINGS,
        modalities=MODALITIES,
        notes=notes(),
        tasks=len(suite.tasks),
        episodes=len(suite.tasks) * suite.episodes_per_task,
        efficiency=efficiency_plot(board),
        widths=(("wide", WIDE), ("narrow", NARROW)),
        amount=amount,
        draw_cells=draw_cells,
    )


def draw_cells(cells: Sequence[Cell], edges: frozenset[int]) -> Markup:
    """Draw the cells of a row; those at ``edges`` begin a block.

    In Python, not in the template: of a thousand rows this is most of the page.
    """
    parts = []
    for index, cell in enumerate(cells):
        key = "" if cell.sort_key is None else f' data-key="{cell.sort_key}"'
        first = ' class="first"' if index in edges else ""
        small = f"<small>{html.escape(cell.small)}</small>" if cell.small else ""
        gauge = draw_gauge(cell.gauge) if cell.gauge else ""
        parts.append(f"<td{key}{first}>{html.escape(cell.text)}{small}{gauge}</td>")
    return Markup("".join(parts))


def efficiency_plot(board: Board) -> Plot | None:
    """Draw mean success against training steps on a logarithmic axis.

    Rows without training are left out; None where that leaves none.
    """
    trained = [row for row in board.ranked if row.training_steps > 0]
    if not trained:
        return None
    powers = [math.log10(row.training_steps) for row in trained]
    first = math.floor(min(powers))
    last = max(math.ceil(max(powers)), first + 1)
    ticks = tuple(Tick(power, amount(10**power)) for power in range(first, last + 1))
    axis = Axis("Control steps of the whole training", first, last, ticks)
    few = len(trained) <= FEW_POINTS
    marks = [
        mark
        for power, row in zip(powers, trained, strict=True)
        for mark in _efficiency_marks(power, row, few)
    ]
    chart = Chart(axis, share_axis("Mean success"), tuple(marks), 270)
    return Plot("", "Mean success against training steps", (chart,))


def _efficiency_marks(power: float, row: BoardRow, few: bool) -> list[Mark]:
    found = row.figures[OVERALL][MEAN_SUCCESS]
    name, steps = row.name, amount(row.training_steps)
    dot = Dot(
        power,
        found.value,
        "series-0",
        size=10 if few else 6,
        label=name if few else "",
        link=f"submission/{name}.html",
        title=f"{name}: {found.value:.3f} after {steps} control steps",
    )
    interval = Line(((power, found.low), (power, found.high)), "series-0", 1.5, 0.45)
    return [interval, dot] if few else [dot]


def _copy_videos(videos: Sequence[str], submission: Path, pages: Path) -> None:
    """Copy a submission's videos beside its page, and remove those it no longer has."""
    kept = set()
    for path in videos:
        source, target = submission / path, pages / video_address(submission.name, path)
        kept.add(target)
        with os_errors_as(RunDirectoryError, source, "copied"):
            if not target.exists() or target.stat().st_mtime_ns < source.stat().st_mtime_ns:
                write_file(target, read_file(source, MAX_VIDEO))
    for other in (pages / submission.name).glob("*"):
        if other not in kept:
            other.unlink()


def _remove_others(pages: Path, names: Collection[str]) -> None:
    """Remove the pages and videos of submissions that are no longer there."""
    if not pages.is_dir():
        return
    for path in pages.iterdir():
        if path.is_dir() and path.name not in names:
            shutil.rmtree(path, ignore_errors=True)
        elif path.suffix == ".html" and path.stem not in names:
            path.unlink()
