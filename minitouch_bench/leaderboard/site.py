"""From a directory of submissions to the files of the leaderboard and its static site.

The site is an index and a page per submission, each complete in itself.
"""

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path

from minitouch_bench import files
from minitouch_bench.errors import RunDirectoryError, UsageError, printable
from minitouch_bench.files import os_errors_as, write_file
from minitouch_bench.json_io import write_json
from minitouch_bench.leaderboard import proof, views
from minitouch_bench.leaderboard.board import (
    COLUMN_SPECS,
    TOUCH_METRICS,
    Board,
    BoardRow,
    make_board,
)
from minitouch_bench.leaderboard.ranking import OVERALL, RANKED_BY
from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS, MAX_VIDEO, MODALITIES
from minitouch_bench.leaderboard.validation import SubmissionFindings, validate
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import TABLE4_METRICS
from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL
from minitouch_bench.reporting import labels, pages, tables
from minitouch_bench.reporting.charts import Figure
from minitouch_bench.reporting.figures import steps_figure, touch_figure
from minitouch_bench.reporting.labels import group_faults, task_title
from minitouch_bench.reporting.report import Video
from minitouch_bench.reporting.report_tables import gap_cells
from minitouch_bench.reporting.tables import Row, Table
from minitouch_bench.runs.run import Run

TEMPLATES = Path(__file__).parent / "templates"
STYLES = ("board.css",)

BOARD_FILE = "leaderboard.json"

PAGES, SITE_PICTURES = "submission", "pictures"
"""Directories of the submissions' pages, and of the tasks' pictures, in the site."""


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
    findings = []
    for directory in find_submissions(submissions):
        findings.append(validate(directory, trust_proofs=True))
        try:
            proof.read_proof(proof.proof_path(directory))
        except RunDirectoryError as error:
            log(f"{printable(directory.name)} is listed without a proof: {error}")
    board = make_board(findings)
    shown = views.views(board)
    page_folder = output / PAGES
    for folder in (page_folder, output / SITE_PICTURES):
        files.make_folder(folder)
    rows = {row.name: row for row in board.rows}
    written = set()
    write_file(output / "leaderboard.md", views.board_markdown(board, shown))
    write_file(output / BOARD_FILE, write_json(board))
    write_file(output / "index.html", index_html(board, shown))
    for found in findings:
        if found.passed:
            page = page_folder / f"{found.submission.name}.html"
            write_file(page, submission_page(found, rows[page.stem], board), durable=False)
            written |= {page, *_copy_videos(found, page_folder)}
    _remove_others(page_folder, written)
    for task in BOARD_TASKS:
        picture = pages.PICTURES / f"{task}.png"
        write_file(output / SITE_PICTURES / picture.name, picture.read_bytes())
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


def _copy_videos(found: SubmissionFindings, folder: Path) -> Iterator[Path]:
    """Copy a submission's videos beside its page, and yield where each of them is then."""
    for path in found.videos():
        source, target = found.directory / path, folder / video_address(found.submission.name, path)
        files.make_folder(target.parent)
        with os_errors_as(RunDirectoryError, source, "copied"):
            write_file(target, files.read_file(source, MAX_VIDEO), durable=False)
        yield target


def video_address(name: str, path: str) -> str:
    """Return where a submission's video lies beside its page."""
    # The parts were checked: seed, suite, "videos", and a plain name.
    return f"{name}/{path.replace(f'/{files.VIDEOS}/', '-').replace('/', '-')}"


def _remove_others(folder: Path, written: Container[Path]) -> None:
    """Remove the pages and videos of an earlier board that this one does not have.

    No link is followed, and what is called otherwise than they are stays.
    """
    inner = [*filter(files.is_folder, folder.iterdir())]
    videos = chain.from_iterable(one.glob("seed-*.mp4") for one in inner)
    with os_errors_as(RunDirectoryError, folder, "cleared"):
        for path in (*folder.glob("*.html"), *videos):
            if path not in written and path.is_file() and not path.is_symlink():
                path.unlink()
        for one in inner:
            with suppress(OSError):  # something is in it
                one.rmdir()


# The index


def index_html(board: Board, shown: Sequence[views.BoardView]) -> str:
    """Write the index."""
    suite = PROTOCOL.suite(MAIN_SUITE)
    return pages.render_page(
        TEMPLATES / "board.html.j2",
        STYLES,
        ("theme.js", "board.js"),
        board=board,
        views=shown,
        columns={name: column for name, column in COLUMN_SPECS.items() if column.place == "column"},
        beside={name: column for name, column in COLUMN_SPECS.items() if column.place == "name"},
        levels=list(proof.ProofLevel),
        meanings=proof.MEANINGS,
        modalities={
            name: meaning
            for name, meaning in MODALITIES.items()
            if any(name in row.modalities for row in board.rows)
        },
        notes=views.notes(),
        tasks=len(suite.tasks),
        episodes=len(suite.tasks) * suite.episodes_per_task,
    )


# The page of a submission


def submission_page(found: SubmissionFindings, row: BoardRow, board: Board) -> str:
    """Write the page of a submission, whose row is on the ``board``."""
    path = f"{found.directory.resolve().parent.name}/{row.name}"
    ranks = {key: f"rank {rank}" for key, rank in row.ranks.items()}
    return pages.render_page(
        TEMPLATES / "submission.html.j2",
        STYLES,
        ("theme.js", "episodes.js"),
        protocol=PROTOCOL.name,
        row=row,
        facts=COLUMN_SPECS,
        seeds=found.submission.seeds,
        runs=found.runs,
        path=path,
        rank=f"{ranks[OVERALL]} of {len(board.ranked)}" if ranks else "",
        why=[
            (task_title(key), ranks[key], views.explain_rank(board, row, key))
            for key in RANKED_BY
            if ranks
        ],
        can_be_run=proof.can_be_run(found.runs),
        level=list(proof.ProofLevel).index(row.proof),
        meaning=proof.MEANINGS[row.proof],
        cards=tuple(_card(row, task, ranks.get(task, "")) for task in BOARD_TASKS),
        values=_values(row),
        gaps=_gaps(row) if row.novel_shapes else None,
        figures=submission_figures(found),
        episodes=pages.browser_data(
            [
                pages.BrowsedRun(folder, run, f"{path}/{folder}")
                for folder, run in found.runs.items()
            ]
        ),
        videos=[
            Video(_caption(found, video), video_address(row.name, video))
            for video in found.videos()
        ],
        faults=_faults(found.runs),
    )


def _caption(found: SubmissionFindings, video: str) -> str:
    """Return what a video shows, and how that episode ended."""
    folder, stem = video.partition(f"/{files.VIDEOS}/")[0], Path(video).stem
    for spec, episode in found.runs[folder].specs_and_rows():
        if spec.key.replace("/", "-") == stem:
            ending, steps = pages.ending_of(episode), episode.steps
            return f"{folder}, {spec.key}: {ending}, {steps} control steps"
    return stem


def _card(row: BoardRow, task: str, rank: str) -> pages.Card:
    card = pages.make_card(task, [(row.name, row.figures[task])], f"../pictures/{task}.png", rank)
    (value,) = card.values
    return replace(card, values=(replace(value, cell=views.with_learned(value.cell, row, task)),))


def _values(row: BoardRow) -> Table:
    rows = []
    for metric in (*TABLE4_METRICS, *TOUCH_METRICS):
        cells = (labels.estimate_cell(metric, row.estimate(task, metric)) for task in BOARD_TASKS)
        rows.append(Row((labels.metric_head(metric), METRICS[metric].unit), tuple(cells)))
    note = f"{views.EPISODE_VARIANCE[0].upper()}{views.EPISODE_VARIANCE[1:]}."
    if len(row.training_seeds) > 1:
        learned = (row.learned_in(task).removesuffix(" seeds learned") for task in BOARD_TASKS)
        rows.append(tables.make_row(("Learned", "seeds"), *learned))
        note = views.SEED_VARIANCE
    return Table(
        title="All values",
        corner=("Metric", "Unit"),
        columns=tables.make_columns(*map(task_title, BOARD_TASKS)),
        rows=tuple(rows),
        notes=(f"Brackets: 95 % interval. {note}",),
    )


def _gaps(row: BoardRow) -> Table:
    rows = (
        Row(
            (task_title(task), METRICS[RANKED_BY[task]].label),
            gap_cells(task, RANKED_BY[task], gap),
        )
        for task, gap in row.novel_shapes.items()
    )
    columns = tables.make_columns("Held-out", "Train", "Gap", "Verdict", words=("Verdict",))
    return Table("Novel shapes", ("Task", "Metric"), columns, tuple(rows))


def _faults(runs: Mapping[str, Run]) -> Mapping[str, Sequence[str]]:
    """Return each fault's text with its episodes, which a run names where there are several."""
    return group_faults(
        (f"{folder} {key}" if len(runs) > 1 else key, text)
        for folder, run in runs.items()
        for key, text in run.faults.items()
    )


def submission_figures(found: SubmissionFindings) -> tuple[Figure, ...]:
    """Return how long a submission's episodes last, and its touch over time."""
    several = "; a line per training seed" if len(found.submission.seeds) > 1 else ""
    played = {task: [*chain(*found.episodes(task))] for task in BOARD_GOALS}
    return (
        steps_figure({task: {"": episodes} for task, episodes in played.items()}),
        touch_figure(BOARD_TASKS, found.runs_on(MAIN_SUITE), more=several),
    )
