"""From a directory of submissions to the files of a board."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.documents import write_json
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.files import list_videos, write_file
from minitouch_bench.leaderboard.board import (
    BoardRow,
    LeftOut,
    Refusal,
    ScoredSubmission,
    make_board,
)
from minitouch_bench.leaderboard.board_files import board_csv, board_markdown
from minitouch_bench.leaderboard.copies import episode_digests
from minitouch_bench.leaderboard.entries import Entry, count_endings, make_entry
from minitouch_bench.leaderboard.kept_rows import KeptRows
from minitouch_bench.leaderboard.page import submission_page
from minitouch_bench.leaderboard.proof import proof_path, read_proof
from minitouch_bench.leaderboard.scores import RANKED_BY, score, score_gaps
from minitouch_bench.leaderboard.site import write_site
from minitouch_bench.leaderboard.submission import BOARD_TASKS
from minitouch_bench.leaderboard.validation import Depth, validate
from minitouch_bench.leaderboard.views import views
from minitouch_bench.processes import core_count, run_in_workers
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.records import Role
from minitouch_bench.rendering.escaping import printable

MANY = 64
"""Submissions from which on the start of worker processes is worth its second."""

TOLD = ("name", "method", "authors", "paper", "code", "license", "training_steps", "modalities",
        "notes")  # fmt: skip
"""What a row repeats of its submission."""


@dataclass(frozen=True)
class Built:
    """What became of the submissions. ``refused`` carries the reasons, ``new`` were not kept."""

    ranked: int
    apart: int
    refused: tuple[LeftOut, ...]
    new: int


def build_board(
    submissions: Path, output: Path, log: Callable[[str], None] = lambda _: None
) -> Built:
    """Check every submission, rank those of this protocol, and write the board.

    One that does not pass is left out with its reasons and does not stop the others. One whose
    proof cannot be read is listed without it, and ``log`` takes why. What an earlier build found
    of a submission is used again as long as nothing it depends on changes.

    Raises:
        UsageError: there is no such directory.
        RunDirectoryError: a file cannot be read or written.
    """
    rows = KeptRows(output)
    digests = {path: rows.digest(path) for path in find_submissions(submissions)}
    kept = {path: rows.find(digest) for path, digest in digests.items()}
    missing = [path for path, row in kept.items() if row is None]
    for path, row in zip(missing, score_submissions(missing), strict=True):
        kept[path] = row
        rows.keep(digests[path], row)
    log(f"{len(digests)} submissions, {len(missing)} new or changed")
    for path in digests:
        try:
            read_proof(proof_path(path.resolve()))
        except RunDirectoryError as error:
            log(f"{printable(path.name)} is listed without a proof: {error}")
    board = make_board(row for row in kept.values() if row is not None)
    tables = views(board)
    write_file(output / "leaderboard.md", board_markdown(board, tables))
    write_file(output / "leaderboard.csv", board_csv(board))
    write_file(output / "leaderboard.json", write_json(board))
    scored = [row for row in kept.values() if isinstance(row, ScoredSubmission)]
    write_site(board, tables, scored, submissions, output)
    rows.finish()
    return Built(len(board.ranked), len(board.other_protocol), board.refused, len(missing))


def find_submissions(directory: Path) -> list[Path]:
    """Return the directories of submissions; names that begin with "_" or "." are none.

    Raises:
        UsageError: there is no such directory.
    """
    if not directory.is_dir():
        raise UsageError(f"{directory} is no directory of submissions; name one with --submissions")
    return sorted(
        path
        for path in directory.iterdir()
        if not path.name.startswith(("_", ".")) and (path.is_dir() or path.is_symlink())
    )


def score_submissions(directories: Sequence[Path]) -> list[ScoredSubmission | Refusal]:
    """Check submissions and estimate all that a board shows of them; many on every core."""
    if len(directories) < MANY:
        return [_score(directory) for directory in directories]
    found = dict(run_in_workers(_score, directories, core_count(), name=str))
    return [found[index] for index in range(len(directories))]


def _score(directory: Path) -> ScoredSubmission | Refusal:
    verdict = validate(directory, Depth.BOARD)
    if verdict.passed:
        return _scored(make_entry(verdict))
    reasons = tuple(map(str, verdict.problems))
    return Refusal(printable(directory.name), reasons, verdict.is_other_protocol)


def _scored(entry: Entry) -> ScoredSubmission:
    about, runs = entry.verdict.submission, entry.verdict.runs
    listed = {task: entry.episodes(MAIN_SUITE, Role.FINAL, task) for task in BOARD_TASKS}
    row = BoardRow(
        **{name: getattr(about, name) for name in TOLD},
        proof=entry.level,
        rerun_episodes=entry.proof.rerun_episodes if entry.proof else 0,
        fresh=entry.proof.fresh if entry.proof else None,
        same_episodes_as=(),
        training_seeds=tuple(seed.seed for seed in about.seeds),
        runs={place: run.digest for place, run in runs.items()},
        ranks={},
        figures=score(entry),
        novel_shapes=score_gaps(entry),
        endings={task: count_endings(own, task) for task, own in listed.items()},
    )
    directory = entry.verdict.directory
    videos = [video for place in runs for video in list_videos(directory / place)]
    scored = ScoredSubmission(
        row,
        values={
            task: tuple(tuple(one.values[RANKED_BY[task]].tolist()) for one in own)
            for task, own in listed.items()
        },
        episodes={
            seed.runs[MAIN_SUITE]: episode_digests(runs[seed.runs[MAIN_SUITE]])
            for seed in about.seeds
        },
        videos=tuple(video.relative_to(directory).as_posix() for video in videos),
    )
    return replace(scored, page=submission_page(entry, scored))
