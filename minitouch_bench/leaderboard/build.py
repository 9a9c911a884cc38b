"""From a directory of submissions to the files of a board."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.errors import UsageError
from minitouch_bench.files import write_file
from minitouch_bench.leaderboard.board import make_board
from minitouch_bench.leaderboard.board_csv import board_csv
from minitouch_bench.leaderboard.board_json import board_json
from minitouch_bench.leaderboard.board_markdown import board_markdown
from minitouch_bench.leaderboard.entries import Entry, count_endings, make_entry
from minitouch_bench.leaderboard.kept_rows import KeptRows
from minitouch_bench.leaderboard.page import submission_page
from minitouch_bench.leaderboard.scores import (
    RANKED_BY,
    Figures,
    Refusal,
    ScoredSubmission,
    score,
    score_gaps,
)
from minitouch_bench.leaderboard.site import write_site
from minitouch_bench.leaderboard.submission import BOARD_TASKS, MAIN_SUITE
from minitouch_bench.leaderboard.validation import Depth, validate
from minitouch_bench.leaderboard.views import views
from minitouch_bench.processes import core_count, run_in_workers
from minitouch_bench.records import Role

MANY = 64
"""Submissions from which on the start of worker processes is worth its second."""

TOGETHER = 16
"""Submissions that are scored together: one set of resamples serves them all."""


@dataclass(frozen=True)
class Built:
    """What became of the submissions. ``refused`` carries the reasons, ``new`` were not kept."""

    ranked: int
    apart: int
    refused: tuple[Refusal, ...]
    new: int


def build_board(
    submissions: Path, output: Path, log: Callable[[str], None] = lambda _: None
) -> Built:
    """Check every submission, rank those of this protocol, and write the board.

    One that does not pass is left out with its reasons and does not stop the others. What an
    earlier build found of a submission is used again as long as nothing it depends on changes.

    Raises:
        UsageError: there is no such directory.
        RunDirectoryError: a file cannot be read or written, or a proof is damaged.
    """
    rows = KeptRows(output)
    digests = {path: rows.digest(path) for path in find_submissions(submissions)}
    kept = {path: rows.find(digest) for path, digest in digests.items()}
    missing = [path for path, row in kept.items() if row is None]
    for path, row in zip(missing, _score_all(missing), strict=True):
        kept[path] = row
        rows.keep(digests[path], row)
    log(f"{len(digests)} submissions, {len(missing)} new or changed")
    board = make_board([row for row in kept.values() if row is not None])
    tables = views(board)
    write_file(output / "leaderboard.md", board_markdown(board, tables))
    write_file(output / "leaderboard.csv", board_csv(board))
    write_file(output / "leaderboard.json", board_json(board))
    write_site(board, tables, submissions, output)
    rows.finish()
    return Built(len(board.ranked), len(board.apart), board.refused, len(missing))


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
    """Check submissions and estimate all that a board shows of them."""
    found = [_read(directory) for directory in directories]
    entries = [one for one in found if isinstance(one, Entry)]
    figures = iter(score(entries))
    return [_scored(one, next(figures)) if isinstance(one, Entry) else one for one in found]


def _score_all(directories: Sequence[Path]) -> list[ScoredSubmission | Refusal]:
    """Score many submissions on every core, few of them here."""
    if len(directories) < MANY:
        return score_submissions(directories)
    starts = range(0, len(directories), TOGETHER)
    jobs = [directories[start : start + TOGETHER] for start in starts]
    found = dict(run_in_workers(score_submissions, jobs, core_count(), name=_name))
    return [row for index in range(len(jobs)) for row in found[index]]


def _name(directories: Sequence[Path]) -> str:
    return f"{directories[0].name} to {directories[-1].name}"


def _read(directory: Path) -> Entry | Refusal:
    verdict = validate(directory, Depth.BOARD)
    if verdict.passed:
        return make_entry(verdict)
    reasons = tuple(map(str, verdict.problems))
    return Refusal(verdict.directory.name, reasons, verdict.is_other_protocol)


def _scored(entry: Entry, figures: Figures) -> ScoredSubmission:
    listed = {task: entry.episodes(MAIN_SUITE, Role.FINAL, task) for task in BOARD_TASKS}
    scored = ScoredSubmission(
        about=entry.submission,
        level=entry.level,
        rerun_episodes=entry.proof.rerun_episodes if entry.proof else 0,
        fresh=entry.proof.fresh if entry.proof else None,
        sketches=entry.proof.sketches if entry.proof else {},
        runs={run.place: run.digest for seed in entry.seeds for run in seed.runs.values()},
        figures=figures,
        gaps=score_gaps(entry),
        endings={task: count_endings(own, task) for task, own in listed.items()},
        values={
            task: tuple(tuple(one.values[RANKED_BY[task]].tolist()) for one in own)
            for task, own in listed.items()
        },
        videos=entry.videos,
    )
    return replace(scored, page=submission_page(entry, scored))
