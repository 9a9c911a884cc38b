"""``minitouch-bench leaderboard``: check submissions, play their rows, build the leaderboard."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench import errors
from minitouch_bench.commands import options
from minitouch_bench.commands.options import Command, argument, make_group, option
from minitouch_bench.console import episode_progress, note, print_problems
from minitouch_bench.evaluation.engine import AUTO
from minitouch_bench.files import REPORTS, RESULTS, SUBMISSIONS

BOARD = REPORTS / "leaderboard"

app = make_group(help="Check submissions, play their rows, and build the leaderboard.")

Names = Annotated[list[str], argument("NAME", "Names of submissions, or their directories.")]
Submissions = Annotated[Path, option("DIR", "Directory of all submissions.")]
Results = Annotated[Path, option("DIR", "Directory of the rows' results.")]


def _names(given: list[str], submissions: Path) -> list[str]:
    """Return the names of submissions that are given by their names or directories."""
    places = [(name, Path(name)) for name in given]
    here = submissions.absolute()
    return [place.name if place.absolute().parent == here else name for name, place in places]


@app.command(cls=Command, epilog="Example: minitouch-bench leaderboard check my-policy")
def check(names: Names, *, submissions: Submissions = SUBMISSIONS) -> None:
    """Check the files and words of submissions; exit 1 with the problems. Nothing is executed."""
    from minitouch_bench.leaderboard.submission import check_submission

    is_valid = True
    for name in _names(names, submissions):
        if problems := [*check_submission(submissions / name)]:
            print_problems(name, problems)
            is_valid = False
        else:
            print_problems(name, ["files and rules in order; nothing was loaded"])
    if not is_valid:
        raise typer.Exit(errors.CHECK_FAILED)


@app.command(cls=Command, epilog="Example: minitouch-bench leaderboard play hac --stop-after 5h")
def play(
    names: Names,
    *,
    suite: Annotated[str | None, option("SUITE", "Only this suite of the submissions'.")] = None,
    stop_after: options.StopAfter = None,
    workers: options.Workers = AUTO,
    submissions: Submissions = SUBMISSIONS,
    results: Results = RESULTS,
) -> None:
    """Play rows from their checkpoints: the official suites, and fresh episodes.

    What was played before and is not changed is not played again. After an interruption the same
    command continues.
    """
    from minitouch_bench.evaluation.engine import open_engine, stopping_after
    from minitouch_bench.leaderboard.play import Entry, play_row
    from minitouch_bench.leaderboard.submission import check_submission

    entries = []
    for name in _names(names, submissions):
        if problems := [*check_submission(submissions / name)]:
            print_problems(name, problems)
            raise typer.Exit(errors.CHECK_FAILED)
        entry = Entry.open(submissions / name, results)
        suites = entry.submission.suites
        if suite is not None and suite not in suites:
            raise errors.UsageError(f"{entry.name} is for {', '.join(suites)}, not for {suite}")
        entries.append(entry)
    is_waiting = False
    with episode_progress() as shown, open_engine("local", workers) as engine:
        callbacks = stopping_after(stop_after, shown)
        for entry in entries:
            row = play_row(entry, engine, callbacks, suites=(suite,) if suite else ())
            if row.waiting:
                print_problems(entry.name, [f"it stays waiting: {row.waiting}"])
                is_waiting = True
            else:
                print(entry.results)
    if is_waiting:
        raise typer.Exit(errors.HopelessRunError.exit_code)
    note("next: minitouch-bench leaderboard build")


@app.command(cls=Command, epilog="Example: minitouch-bench leaderboard build --output site")
def build(
    submissions: Submissions = SUBMISSIONS,
    results: Results = RESULTS,
    output: Annotated[Path, option("DIR", "Directory of the leaderboard.")] = BOARD,
) -> None:
    """Write the leaderboard as Markdown, JSON and a site that opens offline."""
    from minitouch_bench.leaderboard.site import build_board

    board = build_board(submissions, output, results)
    for one in (*board.waiting, *board.left_out):
        print_problems(one.name, [one.reason])
    note(
        f"{len(board.ranked)} ranked, {len(board.unranked)} without a rank, "
        f"{len(board.waiting)} waiting, {len(board.left_out)} left out"
    )
    print(output / "index.html")


@app.command(cls=Command, epilog="Example: minitouch-bench leaderboard remove my-policy")
def remove(
    name: Annotated[str, argument("NAME", "Name of the submission.")],
    *,
    submissions: Submissions = SUBMISSIONS,
    results: Results = RESULTS,
) -> None:
    """Remove a submission and its results."""
    from minitouch_bench.leaderboard.packing import remove_submission

    print(*remove_submission(submissions, results, name), sep="\n")
    note("removed; next: minitouch-bench leaderboard build")
