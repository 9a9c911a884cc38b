"""``minitouch-bench leaderboard``: check submissions, and build the leaderboard."""

import os
from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench import errors
from minitouch_bench.cli import options
from minitouch_bench.cli.console import episode_progress, note, print_problems
from minitouch_bench.cli.options import Command, make_group
from minitouch_bench.evaluation.engine import AUTO
from minitouch_bench.files import REPORTS, SUBMISSIONS

app = make_group(help="Check submissions and build the leaderboard.")


@app.command(
    cls=Command, epilog="Example: minitouch-bench leaderboard validate submissions/hac --prove"
)
def validate(
    directories: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR", exists=True, file_okay=False, help="Directories of submissions."
        ),
    ],
    *,
    prove: Annotated[
        bool,
        typer.Option(
            "--prove",
            help="Also replay every recorded action, run 20 sampled episodes of each policy again "
            "with its checkpoint and 50 new episodes per task, and write the proof that the "
            "leaderboard shows.",
        ),
    ] = False,
    workers: options.Workers = AUTO,
) -> None:
    """Check submissions without trusting them; exit 1 with every problem and how to correct it.

    A submission that cannot be read, or whose check cannot be finished, does not stop the others.
    """
    from minitouch_bench.evaluation.engine import open_engine
    from minitouch_bench.leaderboard import proving, validation
    from minitouch_bench.leaderboard.proof import PROOFS

    opening = open_engine("local", workers)
    results = []
    for place in [
        one for one in directories if one.name != PROOFS
    ]:  # which submissions/* names, too
        found = validation.validate(place)
        if found.passed:
            found = validation.fetch_references(found)
        if prove and found.passed:
            with episode_progress() as callbacks, opening as engine:
                found = proving.prove(found, engine, callbacks)
        results.append(found)
        print_problems(found.name, filter(None, (found.error, *found.problems)))
        if found.withdrawn:
            print(f"{errors.printable(found.name)}: its proof ({found.withdrawn}) is withdrawn")
        if found.passed:
            print(f"{errors.printable(found.name)}: valid, {found.level}")
    valid = sum(found.passed for found in results)
    note(f"{valid} of {len(results)} valid")
    if any(not problem.is_unchecked for found in results for problem in found.problems):
        raise typer.Exit(errors.CHECK_FAILED)
    if valid < len(results):
        is_incomplete = any(
            isinstance(found.error, errors.IncompleteCheckError) for found in results
        )
        unchecked = errors.IncompleteCheckError if is_incomplete else errors.RunDirectoryError
        raise typer.Exit(unchecked.exit_code)


@app.command(cls=Command, epilog="Example: minitouch-bench leaderboard build --output site")
def build(
    submissions: Annotated[Path, typer.Option(help="Directory of all submissions.")] = SUBMISSIONS,
    output: Annotated[Path, typer.Option(help="Directory of the leaderboard.")] = REPORTS
    / "leaderboard",
) -> None:
    """Write the leaderboard as Markdown, JSON and a site that opens offline."""
    from minitouch_bench.leaderboard.site import build_board

    board = build_board(submissions, output, note)
    for refusal in board.refused:
        print_problems(refusal.name, refusal.reasons)
    note(
        f"{len(board.ranked)} ranked, {len(board.unranked)} without a rank, "
        f"{len(board.other_protocol)} of another protocol, {len(board.refused)} refused"
    )
    print(output / "index.html")


@app.command(cls=Command, epilog="Example: minitouch-bench leaderboard remove my-policy")
def remove(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the submission.")],
    *,
    submissions: Annotated[Path, typer.Option(help="Directory of all submissions.")] = SUBMISSIONS,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
) -> None:
    """Remove a submission and its proof, after showing what goes."""
    from minitouch_bench.leaderboard.packing import find_removable, remove_submission

    for path, content in (there := find_removable(submissions, name)).items():
        note(f"{path}{os.sep if path.is_dir() else ''}: {content}")
    if not yes:
        if not os.isatty(0):
            raise errors.UsageError("nothing is removed without --yes where no terminal can ask")
        if not typer.confirm(f"Remove {name}?", err=True):
            raise typer.Exit(errors.CHECK_FAILED)
    remove_submission(submissions, there)
    print(*there, sep="\n")
    note("removed; next: minitouch-bench leaderboard build")
