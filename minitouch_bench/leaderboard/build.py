"""From a directory of submissions to the files of a board."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.errors import UsageError
from minitouch_bench.files import write_file
from minitouch_bench.leaderboard.board import make_board
from minitouch_bench.leaderboard.board_csv import board_csv
from minitouch_bench.leaderboard.board_json import board_json
from minitouch_bench.leaderboard.board_markdown import board_markdown
from minitouch_bench.leaderboard.entries import Entry, make_entry
from minitouch_bench.leaderboard.proof import PROOFS, read_proof
from minitouch_bench.leaderboard.site import write_site
from minitouch_bench.leaderboard.validation import Depth, Verdict, validate
from minitouch_bench.processes import run_all


@dataclass(frozen=True)
class Built:
    """What became of the submissions; ``refused`` carries the reasons."""

    ranked: int
    apart: int
    refused: tuple[Verdict, ...]


def build_board(
    submissions: Path, output: Path, log: Callable[[str], None] = lambda _: None
) -> Built:
    """Check every submission, rank those of this protocol, and write the board.

    One that does not pass is left out with its reasons and does not stop the others.

    Raises:
        UsageError: there is no such directory.
        RunDirectoryError: a file cannot be written, or a proof is damaged.
    """
    entries: list[Entry] = []
    apart: list[Verdict] = []
    refused: list[Verdict] = []
    directories = find_submissions(submissions)
    for found in run_all(_read, directories, name=str):
        if isinstance(found, Entry):
            entries.append(found)
        elif found.is_other_protocol:
            apart.append(found)
        else:
            refused.append(found)
    log(f"{len(directories)} read")
    board = make_board(entries, apart, refused)
    write_file(output / "leaderboard.md", board_markdown(board))
    write_file(output / "leaderboard.csv", board_csv(board))
    write_file(output / "leaderboard.json", board_json(board))
    write_site(board, output)
    return Built(len(board.ranked), len(apart), tuple(refused))


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


def _read(directory: Path) -> Entry | Verdict:
    """Check one submission; one that does not pass is told by its verdict, without its runs."""
    verdict = validate(directory, Depth.BOARD)
    if not verdict.passed:
        return Verdict(verdict.directory, verdict.submission, {}, verdict.problems)
    return make_entry(verdict, read_proof(directory.parent / PROOFS / f"{directory.name}.json"))
