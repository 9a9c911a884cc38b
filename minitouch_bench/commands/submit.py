"""``minitouch-bench submit``: pack policies as a submission for the leaderboard."""

import shlex
from collections.abc import Collection, Iterable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from minitouch_bench import errors
from minitouch_bench.commands import options
from minitouch_bench.commands.options import argument, option, output_option
from minitouch_bench.console import episode_progress, note
from minitouch_bench.evaluation.engine import AUTO
from minitouch_bench.files import SUBMISSIONS
from minitouch_bench.json_io import whole_numbers, words
from minitouch_bench.policies.policy import Isolation, isolation_options
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.text import printable

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
        about_option("TEXT", "What learned, as 'PPO, CNN'; the board shows it beside the row."),
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
    trust: options.Trust = False,
) -> None:
    """Pack policies as a submission for the leaderboard.

    Each is loaded in the sandbox and plays one episode per task. A maintainer's machine plays the
    row: no number of a run of yours enters the leaderboard.
    """
    from minitouch_bench.evaluation.engine import open_engine
    from minitouch_bench.json_io import take_table
    from minitouch_bench.leaderboard import packing, submission
    from minitouch_bench.policies.sources import SubmittedTraining

    if isolation == Isolation.NONE:
        raise errors.UsageError("submit plays a policy in the sandbox, or with --isolation process")
    isolated = isolation_options(isolation, trust)
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
        if not any(checkpoints.values()):
            if [name] != policies:
                raise errors.UsageError(
                    f"'{policies[0]}' is a built-in policy: it has a row already"
                )
            about |= {"modalities": ("state",) if name == "scripted" else (), "training_steps": 0}
    given = {"method": method, "learner": learner, "training_steps": training_steps}
    about |= {key: value for key, value in given.items() if value is not None}
    if "training_steps" not in about:
        raise errors.UsageError(
            "--training-steps is missing: control steps of a training, 0 if none; above 0, give "
            "--learner, too"
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
    print(place)
    check = ["minitouch-bench", "leaderboard", "check", name]
    if directory != SUBMISSIONS:
        check += ["--submissions", str(directory)]
    note(f"next: {shlex.join(check)}, and a pull request that adds {place}")


def _refuse_unknown(option_name: str, given: Iterable[str], known: Collection[str]) -> None:
    for word in given:
        if word not in known:
            raise errors.UsageError(
                f"{option_name} has {', '.join(known)}, not '{printable(word)}'"
            )
