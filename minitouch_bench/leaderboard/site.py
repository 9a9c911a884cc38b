"""The static site: an index and a page per submission, each complete in itself."""

import math
import shutil
from collections.abc import Collection, Sequence
from pathlib import Path

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import os_errors_as, read_file, write_file
from minitouch_bench.leaderboard.board import FACTS, Board, BoardRow
from minitouch_bench.leaderboard.board_files import notes
from minitouch_bench.leaderboard.entries import Entry
from minitouch_bench.leaderboard.facts import Place, amount
from minitouch_bench.leaderboard.inventory import MAX_VIDEO
from minitouch_bench.leaderboard.page import STYLES, TEMPLATES, submission_page, video_address
from minitouch_bench.leaderboard.proof import MEANINGS, ProofLevel
from minitouch_bench.leaderboard.scores import MEAN_SUCCESS, OVERALL
from minitouch_bench.leaderboard.submission import BOARD_TASKS, MODALITIES
from minitouch_bench.leaderboard.views import View
from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL
from minitouch_bench.rendering.charts import Axis, Chart, Dot, Line, Mark, Plot, Tick, share_axis
from minitouch_bench.rendering.pages import PICTURES, render_page

WIDE, NARROW = 1124, 340
"""Widths of the plot of all submissions, on a desk and on a phone."""

PAGES = "submission"
"""Directory of the submissions' pages in the site."""


def write_site(
    board: Board, tables: Sequence[View], entries: Sequence[Entry], output: Path
) -> None:
    """Write the index with its tables, the pages, and the pictures and videos they show.

    Pages of submissions that are gone are removed.

    Raises:
        RunDirectoryError: a file cannot be written.
    """
    write_file(output / "index.html", index_html(board, tables))
    pages = output / PAGES
    rows = {row.name: row for row in board.rows}
    for entry in entries:
        name = entry.about.name
        page = submission_page(entry, rows[name], len(board.ranked))
        write_file(pages / f"{name}.html", page, durable=False)
        _copy_videos(entry, pages)
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
        columns={name: fact for name, fact in FACTS.items() if fact.place is Place.COLUMN},
        beside={name: fact for name, fact in FACTS.items() if fact.place is Place.NAME},
        levels=list(ProofLevel),
        meanings=MEANINGS,
        modalities=MODALITIES,
        notes=notes(),
        tasks=len(suite.tasks),
        episodes=len(suite.tasks) * suite.episodes_per_task,
        efficiency=efficiency_plot(board),
        widths=(("wide", WIDE), ("narrow", NARROW)),
    )


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
    marks = [
        mark
        for power, row in zip(powers, trained, strict=True)
        for mark in _efficiency_marks(power, row)
    ]
    chart = Chart(axis, share_axis("Mean success"), tuple(marks), 270)
    return Plot("", "Mean success against training steps", (chart,))


def _efficiency_marks(power: float, row: BoardRow) -> tuple[Mark, Mark]:
    mean = row.figures[OVERALL][MEAN_SUCCESS]
    dot = Dot(
        power,
        mean.value,
        "series-0",
        size=10,
        label=row.name,
        link=f"{PAGES}/{row.name}.html",
        title=f"{row.name}: {mean.value:.3f} after {amount(row.training_steps)} control steps",
    )
    return Line(((power, mean.low), (power, mean.high)), "series-0", 1.5, 0.45), dot


def _copy_videos(entry: Entry, pages: Path) -> None:
    """Copy a submission's videos beside its page, and remove those it no longer has."""
    name, kept = entry.about.name, set()
    for path in entry.videos():
        source, target = entry.verdict.directory / path, pages / video_address(name, path)
        kept.add(target)
        with os_errors_as(RunDirectoryError, source, "copied"):
            if not target.exists() or target.stat().st_mtime_ns < source.stat().st_mtime_ns:
                write_file(target, read_file(source, MAX_VIDEO))
    for other in (pages / name).glob("*"):
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
