"""The commands ``submit`` and ``leaderboard``: pack policies, check and play them as rows."""

import os
from collections.abc import Collection, Iterable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from minitouch_bench import errors
from minitouch_bench.commands import options
from minitouch_bench.commands.options import (
    Command,
    argument,
    flag,
    make_group,
    option,
    output_option,
)
from minitouch_bench.console import episode_progress, note, print_problems
from minitouch_bench.evaluation.engine import AUTO
from minitouch_bench.files import REPORTS, RESULTS, SUBMISSIONS
from minitouch_bench.json_io import whole_numbers, words
from minitouch_bench.policies.policy import Isolation, isolation_options
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.text import printable

BOARD = REPORTS / "leaderboard"

app = make_group(help="Check submissions, play their rows, and build the leaderboard.")

Names = Annotated[list[str], argument("NAME", "Names of submissions.")]
Submissions = Annotated[Path, option("DIR", "Directory of all submissions.")]
Results = Annotated[Path, option("DIR", "Directory of the rows' results.")]
about_option = partial(option, rich_help_panel="What the leaderboard shows")


def submit(
    policies: Annotated[
        list[str],
        argument(
            "POLICY",
            "A policy for each training seed: a checkpoint for all tasks, a directory of one "
            "file per task, or hf://...; or the directories of trainings, in any order.",
        ),
    ],
    *,
    name: Annotated[str, option("NAME", "Name of the submission: a-z, 0-9, '.', '_', '-'.")],
    exploration: Annotated[
        list[str] | None,
        option("POLICY", "Exploration policy of each training, in their order; repeat it."),
    ] = None,
    training_seeds: Annotated[
        str | None,
        about_option("N,N", "Seed of each training, in their order; by default 0, 1, …."),
    ] = None,
    training_steps: Annotated[
        int | None,
        about_option("N", "Control steps of a training, all phases and tasks, or 0.", min=0),
    ] = None,
    learner: Annotated[
        str | None,
        about_option("TEXT", "What learned, as 'PPO, CNN': rows of one learner are compared."),
    ] = None,
    method: Annotated[
        str | None, about_option("TEXT", "Name of the method; by default the training's, or NAME.")
    ] = None,
    suites: Annotated[str, about_option("A,B", "Suites that it is meant for.")] = MAIN_SUITE,
    modalities: Annotated[
        str | None,
        about_option(
            "A,B",
            "What the policy uses: vision, and touch or proprioception (touch without its "
            "forces); by default the training's, or vision,touch.",
        ),
    ] = None,
    authors: Annotated[str | None, about_option("TEXT", "Names, separated by commas.")] = None,
    paper: Annotated[str, about_option("URL", "An https link.")] = "",
    code: Annotated[str, about_option("URL", "An https link.")] = "",
    license_: Annotated[
        str, about_option("TEXT", "SPDX expression, such as Apache-2.0.", "--license")
    ] = "",
    notes: Annotated[str, about_option("TEXT", "Anything else, on one line.")] = "",
    directory: Annotated[Path, output_option("DIR", "Directory of all submissions.")] = SUBMISSIONS,
    workers: options.Workers = AUTO,
    isolation: options.IsolationLevel = Isolation.SANDBOX.value,
) -> None:
    """Pack policies as a submission for the leaderboard.

    Each is loaded in the sandbox and plays one episode per task. A maintainer's machine plays the
    row: no number of a run of yours enters the leaderboard.
    """
    from minitouch_bench.evaluation.engine import open_engine
    from minitouch_bench.json_io import take_table
    from minitouch_bench.leaderboard import packing, submission
    from minitouch_bench.policies.sources import SubmittedTraining

    isolated = isolation_options(isolation, trust=False)
    for_suites, senses = words(suites), words(modalities)
    _refuse_unknown("--suites", for_suites, submission.SUITES)
    _refuse_unknown("--modalities", senses, submission.MODALITIES)
    about: dict[str, Any] = {"method": name, "modalities": ("vision", "touch")}
    if all(map(packing.is_training, policies)):
        if exploration or training_seeds:
            raise errors.UsageError(
                "a training directory has its seed and its exploration policy itself"
            )
        checkpoints, of_trainings = packing.pack_trainings(policies)
        about |= of_trainings
    else:
        seeds = whole_numbers("--training-seeds", training_seeds)
        checkpoints = packing.pack_policies(policies, exploration or [], seeds)
        if not any(checkpoints.values()):  # a built-in policy
            about |= {"modalities": ("state",) if name == "scripted" else (), "training_steps": 0}
    given = {"method": method, "learner": learner, "training_steps": training_steps}
    about |= {key: value for key, value in given.items() if value is not None}
    if "training_steps" not in about:
        raise errors.UsageError(
            "--training-steps is missing: control steps of a training, 0 if none"
        )
    about |= {"modalities": senses} if senses else {}
    about |= {"name": name, "suites": for_suites, "authors": words(authors), "paper": paper}
    about |= {"code": code, "license": license_, "notes": notes}
    about["trainings"] = [
        SubmittedTraining(seed, tuple(found)) for seed, found in checkpoints.items()
    ]
    packed = take_table(about, submission.Submission)
    with episode_progress() as callbacks, open_engine("local", workers) as engine:
        place = packing.pack_submission(
            packed, checkpoints, directory, engine, callbacks, isolation=isolated
        )
    for sentence in submission.equal_checkpoints(directory, packed):
        note(sentence)
    print(place)
    note(f"next: minitouch-bench leaderboard play {name}, then minitouch-bench leaderboard build")


def _refuse_unknown(option_name: str, given: Iterable[str], known: Collection[str]) -> None:
    for word in given:
        if word not in known:
            raise errors.UsageError(
                f"{option_name} has {', '.join(known)}, not '{printable(word)}'"
            )


@app.command(cls=Command, epilog="Example: minitouch-bench leaderboard check my-policy")
def check(names: Names, *, submissions: Submissions = SUBMISSIONS) -> None:
    """Check the files and words of submissions; exit 1 with every problem. Nothing is executed."""
    from minitouch_bench.leaderboard.submission import (
        check_submission,
        equal_checkpoints,
        read_submission,
    )

    is_sound = True
    for name in names:
        if problems := [*check_submission(submissions / name)]:
            print_problems(name, problems)
            is_sound = False
        else:
            copies = equal_checkpoints(submissions, read_submission(submissions / name))
            print_problems(name, ["sound", *copies])
    if not is_sound:
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
    from minitouch_bench.leaderboard.entry import Entry, play_row
    from minitouch_bench.leaderboard.submission import check_submission

    entries = []
    for name in names:
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


@app.command(cls=Command, epilog="Example: minitouch-bench leaderboard remove my-policy --yes")
def remove(
    name: Annotated[str, argument("NAME", "Name of the submission.")],
    *,
    submissions: Submissions = SUBMISSIONS,
    results: Results = RESULTS,
    yes: Annotated[bool, flag("--yes", "Remove it; otherwise what would go is shown.")] = False,
) -> None:
    """Remove a submission and its results."""
    from minitouch_bench.leaderboard.packing import find_removable, remove_submission

    there = find_removable(submissions, results, name)
    for path in there:
        note(f"{path}{os.sep}")
    if not yes:
        raise errors.UsageError("nothing is removed without --yes")
    remove_submission(submissions, there)
    print(*there, sep="\n")
    note("removed; next: minitouch-bench leaderboard build")
