"""From a directory of submissions to the files of the leaderboard and its static site.

The site is an index and a page per submission, each complete in itself.
"""

import math
import os
import re
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.errors import RunDirectoryError, UsageError, printable
from minitouch_bench.files import is_folder, make_folder, os_errors_as, read_file, write_file
from minitouch_bench.json_io import read_json, write_json
from minitouch_bench.leaderboard.board import COLUMN_SPECS, Board, BoardRow, make_board
from minitouch_bench.leaderboard.board_files import board_csv, board_markdown, notes
from minitouch_bench.leaderboard.columns import amount
from minitouch_bench.leaderboard.page import STYLES, TEMPLATES, submission_page, video_address
from minitouch_bench.leaderboard.proof import MEANINGS, ProofLevel, proof_path, read_proof
from minitouch_bench.leaderboard.ranking import MEAN_SUCCESS, OVERALL
from minitouch_bench.leaderboard.submission import BOARD_TASKS, MODALITIES, NAME
from minitouch_bench.leaderboard.submission_checks import MAX_VIDEO
from minitouch_bench.leaderboard.validation import SubmissionFindings, validate
from minitouch_bench.leaderboard.views import BoardView, views
from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL
from minitouch_bench.reporting.charts import Axis, Chart, Dot, Line, Mark, Plot, Tick, share_axis
from minitouch_bench.reporting.pages import PICTURES, render_page

WIDE, NARROW = 1124, 340
"""Widths of the plot of all submissions, on a desk and on a phone."""

BOARD_FILE = "leaderboard.json"

PAGES, SITE_PICTURES = "submission", "pictures"
"""Directories of the submissions' pages, and of the tasks' pictures, in the site."""

COPIED_VIDEO = re.compile(r"seed-\d+-[a-z0-9-]+-\d+\.mp4")
"""What ``video_address`` calls a video in its submission's directory of the site."""


def build_board(
    submissions: Path, output: Path, log: Callable[[str], None] = lambda _: None
) -> Board:
    """Check every submission, rank those of this protocol, and write the leaderboard.

    One that does not pass is left out with its reasons and does not stop the others. One whose
    proof cannot be read is listed without it, and ``log`` takes why. What a proof is for was
    computed again before it was made; without one it is computed here.

    Raises:
        UsageError: there is no such directory.
        RunDirectoryError: a file cannot be read or written.
    """
    verdicts = []
    for directory in find_submissions(submissions):
        verdicts.append(validate(directory, trust_proofs=True))
        try:
            read_proof(proof_path(directory))
        except RunDirectoryError as error:
            log(f"{printable(directory.name)} is listed without a proof: {error}")
    board = make_board(verdicts)
    tables = views(board)
    for folder in (PAGES, SITE_PICTURES):
        make_folder(output / folder)
    _remove_pages(output, {row.name for row in board.rows})
    write_file(output / "leaderboard.md", board_markdown(board, tables))
    write_file(output / "leaderboard.csv", board_csv(board))
    write_file(output / BOARD_FILE, write_json(board))
    _write_site(board, tables, [verdict for verdict in verdicts if verdict.passed], output)
    return board


def find_submissions(directory: Path) -> list[Path]:
    """Return the directories of submissions; names that begin with "_" or "." are none.

    Raises:
        UsageError: there is no such directory, or it cannot be read.
    """
    with os_errors_as(UsageError, directory, "read"):
        if directory.is_dir():
            return sorted(
                path
                for path in directory.iterdir()
                if not path.name.startswith(("_", ".")) and (path.is_dir() or path.is_symlink())
            )
    raise UsageError(f"{directory} is no directory of submissions; name one with --submissions")


def _write_site(
    board: Board, tables: Sequence[BoardView], verdicts: Sequence[SubmissionFindings], output: Path
) -> None:
    """Write the index, the pages, and the pictures and videos they show."""
    write_file(output / "index.html", index_html(board, tables))
    pages = output / PAGES
    rows = {row.name: row for row in board.rows}
    for verdict in verdicts:
        name = verdict.submission.name
        page = submission_page(verdict, rows[name], len(board.ranked))
        write_file(pages / f"{name}.html", page, durable=False)
        _copy_videos(verdict, pages)
    for task in BOARD_TASKS:
        picture = PICTURES / f"{task}.png"
        if picture.exists():  # a new task may have none yet
            write_file(output / SITE_PICTURES / picture.name, picture.read_bytes())


def index_html(board: Board, tables: Sequence[BoardView]) -> str:
    """Write the index."""
    suite = PROTOCOL.suite(MAIN_SUITE)
    return render_page(
        TEMPLATES / "board.html.j2",
        STYLES,
        ("theme.js", "board.js"),
        board=board,
        views=tables,
        columns={name: column for name, column in COLUMN_SPECS.items() if column.place == "column"},
        beside={name: column for name, column in COLUMN_SPECS.items() if column.place == "name"},
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
    """Draw mean success against training steps, logarithmic; None where no row was trained."""
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
    learned = f", {row.learned_in(OVERALL)}" if row.learned_in(OVERALL) else ""
    dot = Dot(
        power,
        mean.value,
        "series-0",
        size=10,
        label=row.name,
        link=f"{PAGES}/{row.name}.html",
        title=f"{row.name}: {mean.value:.3f} after {amount(row.training_steps)} control steps"
        f"{learned}",
    )
    return Line(((power, mean.low), (power, mean.high)), "series-0", 1.5, 0.45), dot


def _copy_videos(verdict: SubmissionFindings, pages: Path) -> None:
    """Copy a submission's videos beside its page, and remove those it no longer has."""
    folder, kept = pages / verdict.submission.name, set()
    for path in verdict.videos():
        source, target = verdict.directory / path, pages / video_address(folder.name, path)
        kept.add(target.name)
        make_folder(folder)
        with os_errors_as(RunDirectoryError, source, "copied"):
            write_file(target, read_file(source, MAX_VIDEO), durable=False)
    _remove_videos(folder, kept)


@dataclass(frozen=True)
class _Listed:
    name: str


@dataclass(frozen=True)
class _EarlierBoard:
    """What is read of the leaderboard that a directory had before."""

    ranked: tuple[_Listed, ...]
    unranked: tuple[_Listed, ...]
    calibration: tuple[_Listed, ...]


def _remove_pages(output: Path, kept: Collection[str]) -> None:
    """Remove the pages and videos of rows that the leaderboard in a directory had before.

    Only files with the names that this program gives are removed, and no link is followed:
    anybody can have written the earlier leaderboard.
    """
    try:
        board = read_json(read_file(output / BOARD_FILE), _EarlierBoard, BOARD_FILE)
    except (OSError, RunDirectoryError):  # there is none, or another file
        return
    rows = (*board.ranked, *board.unranked, *board.calibration)
    named = {row.name for row in rows if re.search(str(NAME.pattern), row.name)}
    for name in named.difference(kept):
        page = output / PAGES / f"{name}.html"
        if page.is_file() and not page.is_symlink():
            with os_errors_as(RunDirectoryError, page, "removed"):
                page.unlink()
        _remove_videos(output / PAGES / name)


def _remove_videos(folder: Path, kept: Collection[str] = ()) -> None:
    """Remove copied videos from a directory of the site, and the directory if it is empty then."""
    if not is_folder(folder):
        return
    with os_errors_as(RunDirectoryError, folder, "cleared"):
        for name in filter(COPIED_VIDEO.fullmatch, os.listdir(folder)):
            if name not in kept and not is_folder(folder / name):
                (folder / name).unlink()
        with suppress(OSError):  # something else is in it
            folder.rmdir()
