"""From a directory of submissions to the files of a board."""

from collections.abc import Callable
from pathlib import Path

from minitouch_bench.documents import write_json
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.files import write_file
from minitouch_bench.leaderboard.board import Board, make_board
from minitouch_bench.leaderboard.board_files import board_csv, board_markdown
from minitouch_bench.leaderboard.entries import Entry
from minitouch_bench.leaderboard.proof import find_proof, level_of, proof_path, read_proof
from minitouch_bench.leaderboard.site import write_site
from minitouch_bench.leaderboard.validation import Verdict, validate
from minitouch_bench.leaderboard.views import views
from minitouch_bench.rendering.escaping import printable


def build_board(
    submissions: Path, output: Path, log: Callable[[str], None] = lambda _: None
) -> Board:
    """Check every submission, rank those of this protocol, and write the board.

    One that does not pass is left out with its reasons and does not stop the others. One whose
    proof cannot be read is listed without it, and ``log`` takes why.

    Raises:
        UsageError: there is no such directory.
        RunDirectoryError: a file cannot be read or written.
    """
    entries: list[Entry] = []
    failed: list[Verdict] = []
    for directory in find_submissions(submissions):
        checked = read_entry(directory)
        if isinstance(checked, Entry):
            entries.append(checked)
        else:
            failed.append(checked)
        try:
            read_proof(proof_path(directory.resolve()))
        except RunDirectoryError as error:
            log(f"{printable(directory.name)} is listed without a proof: {error}")
    board = make_board(entries, failed)
    tables = views(board)
    write_file(output / "leaderboard.md", board_markdown(board, tables))
    write_file(output / "leaderboard.csv", board_csv(board))
    write_file(output / "leaderboard.json", write_json(board))
    write_site(board, tables, entries, output)
    return board


def read_entry(directory: Path) -> Entry | Verdict:
    """Check a submission; return it with its proof if it passes, otherwise what is wrong.

    What a proof is for was computed again before it was made. Without one it is computed here.
    """
    verdict = validate(directory, trust_proofs=True)
    if not verdict.passed:
        return verdict
    proof = find_proof(directory, verdict.runs)
    return Entry(verdict, proof, level_of(verdict.runs, proof))


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
