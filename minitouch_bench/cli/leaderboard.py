"""``minitouch-bench leaderboard``: check submissions, and draw the board."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli.console import EpisodeProgress, notes
from minitouch_bench.errors import IncompleteCheckError, RunDirectoryError
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.workflows import options

INVALID = 1
UNREADABLE = 6
"""A file cannot be read here: the check could not be made."""

app = typer.Typer(help="Check submissions and draw the leaderboard.", no_args_is_help=True)


@app.command(epilog="Example: minitouch-bench leaderboard validate submissions/hac --replay")
def validate(  # noqa: PLR0917 - each parameter is an option of the command
    directories: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Directories of submissions.")
    ],
    replay: Annotated[
        bool, typer.Option("--replay", help="Replay the recorded actions of every episode.")
    ] = False,
    rerun: Annotated[
        int,
        typer.Option(
            min=0,
            max=MAX_EPISODES,
            help="Run N drawn episodes of each run with the checkpoint, too.",
        ),
    ] = 0,
    fresh_seeds: Annotated[
        int,
        typer.Option(
            min=0,
            max=MAX_EPISODES,
            help="Run N new episodes per task of each run, too, on seeds drawn now: 50 is usual, "
            "fewer than 20 give no level.",
        ),
    ] = 0,
    draw: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            help="Draw the new seeds from this text, which the submitter must not know before the "
            "checkpoint is fixed; by default 128 random bits.",
        ),
    ] = None,
    workers: options.WorkersText = options.AUTO,
    time_limit: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            min=1.0,
            help="Seconds that the check of each submission may take; by default 6 hours.",
        ),
    ] = None,
) -> None:
    """Check submissions without trusting them; exit 1 with every problem and how to correct it.

    With --replay, --rerun or --fresh-seeds a proof is written beside them, which the board shows.
    """
    from minitouch_bench.leaderboard.proof import MIN_FRESH_EPISODES
    from minitouch_bench.rendering.escaping import printable
    from minitouch_bench.verification.fresh import new_draw
    from minitouch_bench.workflows.validate import ValidateOptions, validate_submission

    engine = options.engine_options("local", workers, None)
    asked = ValidateOptions(replay, rerun, fresh_seeds, draw or new_draw(), engine)
    if time_limit is not None:
        asked = replace(asked, time_limit_s=time_limit)
    valid, unchecked, incomplete = 0, True, False
    for directory in directories:
        name = printable(directory.name or str(directory))
        try:
            with EpisodeProgress(notes) as progress:
                found = validate_submission(directory, asked, progress.callbacks)
        except IncompleteCheckError as error:
            _show_problems(name, [error])
            incomplete = True
            continue
        except RunDirectoryError as error:
            _show_problems(name, [error])
            continue
        valid += not found.problems
        unchecked = unchecked and all(problem.is_unchecked for problem in found.problems)
        _show_problems(name, found.problems)
        if found.withdrawn:
            print(f"{name}: its proof ({found.withdrawn}) is withdrawn")
        if not found.problems:
            print(f"{name}: valid, {found.level}")
    if 0 < fresh_seeds < MIN_FRESH_EPISODES:
        few = f"fewer than {MIN_FRESH_EPISODES} fresh episodes per task give no level"
        notes.print(few, markup=False)
    notes.print(f"{valid} of {len(directories)} valid", markup=False)
    if not unchecked:
        raise typer.Exit(INVALID)
    if valid < len(directories):
        raise typer.Exit(IncompleteCheckError.exit_code if incomplete else UNREADABLE)


@app.command(epilog="Example: minitouch-bench leaderboard build --output site")
def build(
    submissions: Annotated[Path, typer.Option(help="Directory that holds the submissions.")] = Path(
        "submissions"
    ),
    output: Annotated[Path, typer.Option(help="Directory of the board.")] = Path(
        "reports/leaderboard"
    ),
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit 1 if any submission is refused.")
    ] = False,
) -> None:
    """Write the board as Markdown, CSV, JSON and a site that opens offline."""
    from minitouch_bench.leaderboard.build import build_board

    board = build_board(submissions, output, lambda line: notes.print(line, markup=False))
    for refusal in board.refused:
        _show_problems(refusal.name, refusal.reasons)
    notes.print(
        f"{len(board.ranked)} ranked, {len(board.other_protocol)} of another protocol, "
        f"{len(board.refused)} refused",
        markup=False,
    )
    print(output / "index.html")
    if strict and board.refused:
        raise typer.Exit(INVALID)


def _show_problems(name: str, problems: Iterable[object]) -> None:
    from minitouch_bench.rendering.escaping import printable

    for problem in problems:
        print(f"{printable(name)}: {problem}")
