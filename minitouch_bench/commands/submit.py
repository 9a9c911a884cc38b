"""The command ``submit``: pack policies as a submission."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import episode_progress, note
from minitouch_bench.cli.options import output_option
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.engine import AUTO
from minitouch_bench.files import SUBMISSIONS
from minitouch_bench.json_io import whole_numbers, words
from minitouch_bench.policies.policy import Isolation, isolation_options
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.text import printable

about_option = partial(typer.Option, rich_help_panel="What the leaderboard shows")


def submit(
    policies: Annotated[
        list[str],
        typer.Argument(
            metavar="POLICY",
            help="A policy for each training seed: a checkpoint for all tasks, a directory of one "
            "file per task, or hf://...; or the directories of trainings, in any order.",
        ),
    ],
    *,
    name: Annotated[str, typer.Option(help="Name of the submission: a-z, 0-9, '.', '_', '-'.")],
    exploration: Annotated[
        list[str] | None,
        typer.Option(
            metavar="POLICY",
            help="Exploration policy of each training, in the order of the policies; repeat it.",
        ),
    ] = None,
    training_seeds: Annotated[
        str | None,
        about_option(
            metavar="N,N", help="Seed of each training, in their order; by default 0, 1, …."
        ),
    ] = None,
    training_steps: Annotated[
        int | None,
        about_option(
            metavar="N",
            min=0,
            help="Control steps of a whole training, all phases and tasks; 0 if none.",
        ),
    ] = None,
    learner: Annotated[
        str | None,
        about_option(
            metavar="TEXT",
            help="What learned, so that rows of one learner can be compared, such as 'PPO, CNN'.",
        ),
    ] = None,
    method: Annotated[
        str | None,
        about_option(
            metavar="TEXT", help="Name of the method; by default the training's, or NAME."
        ),
    ] = None,
    suites: Annotated[
        str, about_option(metavar="A,B", help="Suites that it is meant for.")
    ] = MAIN_SUITE,
    modalities: Annotated[
        str | None,
        about_option(
            metavar="A,B",
            help="What the policy uses: vision, and touch or proprioception (touch without its "
            "forces); by default the training's, or vision,touch.",
        ),
    ] = None,
    authors: Annotated[str | None, about_option(help="Names, separated by commas.")] = None,
    paper: Annotated[str, about_option(help="An https link.")] = "",
    code: Annotated[str, about_option(help="An https link.")] = "",
    license_: Annotated[
        str, about_option("--license", help="SPDX expression, such as Apache-2.0.")
    ] = "",
    notes: Annotated[str, about_option(help="Anything else, on one line.")] = "",
    directory: Annotated[Path, output_option(help="Directory of all submissions.")] = SUBMISSIONS,
    workers: options.Workers = AUTO,
    isolation: options.IsolationLevel = Isolation.SANDBOX.value,
) -> None:
    """Pack policies as a submission for the leaderboard.

    Each is loaded in the sandbox and plays one episode per task. A maintainer's machine plays the
    row: no number of a run of yours enters the leaderboard.
    """
    from minitouch_bench.evaluation.engine import open_engine
    from minitouch_bench.json_io import take_table
    from minitouch_bench.leaderboard import packing
    from minitouch_bench.leaderboard.submission import (
        MODALITIES,
        SUITES,
        Submission,
        equal_checkpoints,
    )
    from minitouch_bench.policies.sources import SubmittedTraining

    isolated = isolation_options(isolation, trust=False)
    for option, listed, known in (
        ("--suites", words(suites), SUITES),
        ("--modalities", words(modalities), MODALITIES),
    ):
        if unknown := [word for word in listed if word not in known]:
            raise UsageError(f"{option} has {', '.join(known)}, not '{printable(unknown[0])}'")
    told: dict[str, Any] = {"method": name, "learner": "", "modalities": ("vision", "touch")}
    if all(map(packing.is_training, policies)):
        if exploration or training_seeds:
            raise UsageError("a training directory has its seed and its exploration policy itself")
        checkpoints, of_trainings = packing.pack_trainings(policies)
        told |= of_trainings
    else:
        seeds = whole_numbers("--training-seeds", training_seeds)
        checkpoints = packing.pack_policies(policies, exploration or [], seeds)
        if not any(checkpoints.values()):  # a built-in policy
            told |= {"modalities": ("state",) if name == "scripted" else (), "training_steps": 0}
    given = {
        "method": method,
        "learner": learner,
        "training_steps": training_steps,
        "modalities": words(modalities) or None,
    }
    told |= {key: value for key, value in given.items() if value is not None}
    if "training_steps" not in told:
        raise UsageError("--training-steps is missing: control steps of a training, 0 if none")
    told |= {"name": name, "suites": words(suites), "authors": words(authors)}
    told |= {"paper": paper, "code": code, "license": license_, "notes": notes}
    told["trainings"] = [
        SubmittedTraining(seed, tuple(found)) for seed, found in checkpoints.items()
    ]
    submission = take_table(told, Submission)
    with episode_progress() as callbacks, open_engine("local", workers) as engine:
        place = packing.pack_submission(
            submission, checkpoints, directory, engine, callbacks, isolation=isolated
        )
    for sentence in equal_checkpoints(directory, submission):
        note(sentence)
    print(place)
    note(f"next: minitouch-bench leaderboard play {name}, then minitouch-bench leaderboard build")
