"""The static site: an index and a page per submission, each complete in itself."""

import shutil
from functools import partial
from pathlib import Path

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import os_errors_as, read_file, write_file
from minitouch_bench.leaderboard.board import Board, BoardRow
from minitouch_bench.leaderboard.board_markdown import notes
from minitouch_bench.leaderboard.figures import amount, efficiency_plot
from minitouch_bench.leaderboard.inventory import MAX_VIDEO
from minitouch_bench.leaderboard.page import page_context
from minitouch_bench.leaderboard.proof import MEANINGS, ProofLevel
from minitouch_bench.leaderboard.submission import MAIN_SUITE, MODALITIES
from minitouch_bench.leaderboard.views import views
from minitouch_bench.processes import run_all
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.rendering.cards import PICTURES
from minitouch_bench.rendering.pages import render_page
from minitouch_bench.reporting.labels import TASKS
from minitouch_bench.reporting.report import Video

TEMPLATES = Path(__file__).parent / "templates"
STYLES = ("board.css",)
WIDE, NARROW = 1124, 340
"""Widths of the plot of all submissions, on a desk and on a phone."""

PAGES = "submission"
"""Directory of the submissions' pages in the site."""


def write_site(board: Board, output: Path) -> None:
    """Write the index, the pages, and the pictures and videos they show.

    Pages of submissions that are gone are removed.

    Raises:
        RunDirectoryError: a file cannot be written.
    """
    write_file(output / "index.html", index_html(board))
    pages = output / PAGES
    write = partial(_write_page, pages, board.protocol, len(board.ranked))
    run_all(write, board.rows, name=lambda row: f"the page of {row.entry.name}")
    _remove_others(pages, {row.entry.name for row in board.rows})
    for task in TASKS:
        name = f"{task}.png"
        write_file(output / "pictures" / name, (PICTURES / name).read_bytes())


def index_html(board: Board) -> str:
    """Write the index."""
    suite = PROTOCOL.suite(MAIN_SUITE)
    return render_page(
        TEMPLATES / "board.html.j2",
        STYLES,
        ("theme.js", "board.js"),
        board=board,
        views=views(board),
        levels=list(ProofLevel),
        meanings=MEANINGS,
        modalities=MODALITIES,
        notes=notes(),
        tasks=len(suite.tasks),
        episodes=len(suite.tasks) * suite.episodes_per_task,
        efficiency=efficiency_plot(board),
        widths=(("wide", WIDE), ("narrow", NARROW)),
        amount=amount,
    )


def _write_page(pages: Path, protocol: str, ranked: int, row: BoardRow) -> None:
    """Write the page of one submission of ``ranked``, and its videos."""
    text = render_page(
        TEMPLATES / "submission.html.j2",
        STYLES,
        ("theme.js", "submission.js"),
        protocol=protocol,
        videos=_copy_videos(row, pages),
        **page_context(row, ranked),
    )
    write_file(pages / f"{row.entry.name}.html", text)


def _copy_videos(row: BoardRow, pages: Path) -> tuple[Video, ...]:
    """Copy a submission's videos beside its page."""
    target = pages / row.entry.name
    shutil.rmtree(target, ignore_errors=True)
    found = []
    for path in row.entry.videos:
        # The parts were checked: seed, suite, "videos", and a plain name.
        name = path.replace("/videos/", "-").replace("/", "-")
        with os_errors_as(RunDirectoryError, row.entry.directory / path, "copied"):
            write_file(target / name, read_file(row.entry.directory / path, MAX_VIDEO))
        found.append(Video(Path(name).stem.replace("-", " "), f"{row.entry.name}/{name}"))
    return tuple(found)


def _remove_others(pages: Path, names: set[str]) -> None:
    """Remove the pages and videos of submissions that are no longer there."""
    if not pages.is_dir():
        return
    for path in pages.iterdir():
        if path.is_dir() and path.name not in names:
            shutil.rmtree(path, ignore_errors=True)
        elif path.suffix == ".html" and path.stem not in names:
            path.unlink()
