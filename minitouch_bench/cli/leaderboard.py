"""``minitouch-bench leaderboard``: check submissions, and build the leaderboard."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli.command import Command, make_group
from minitouch_bench.cli.console import note, print_problems
from minitouch_bench.errors import CHECK_FAILED
from minitouch_bench.files import REPORTS, SUBMISSIONS
from minitouch_bench.workflows.validate import validate

app = make_group(help="Check submissions and build the leaderboard.")
app.command(
    cls=Command, epilog="Example: minitouch-bench leaderboard validate submissions/hac --prove"
)(validate)


@app.command(cls=Command, epilog="Example: minitouch-bench leaderboard build --output site")
def build(
    submissions: Annotated[Path, typer.Option(help="Directory of all submissions.")] = SUBMISSIONS,
    output: Annotated[Path, typer.Option(help="Directory of the leaderboard.")] = REPORTS
    / "leaderboard",
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit 1 if any submission is refused.")
    ] = False,
) -> None:
    """Write the leaderboard as Markdown, CSV, JSON and a site that opens offline."""
    from minitouch_bench.leaderboard.build import build_board

    board = build_board(submissions, output, note)
    for refusal in board.refused:
        print_problems(refusal.name, refusal.reasons)
    note(
        f"{len(board.ranked)} ranked, {len(board.other_protocol)} of another protocol, "
        f"{len(board.refused)} refused"
    )
    print(output / "index.html")
    if strict and board.refused:
        raise typer.Exit(CHECK_FAILED)
