"""The command ``submit``: pack finished runs as a submission."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli.console import note, print_problems
from minitouch_bench.cli.options import output_option
from minitouch_bench.errors import CHECK_FAILED, UsageError
from minitouch_bench.files import SUBMISSIONS
from minitouch_bench.json_io import whole_numbers, words

about_option = partial(typer.Option, rich_help_panel="What the leaderboard shows")
DEFAULT_MODALITIES = ("vision", "touch")


def submit(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN", help="Official runs.")],
    *,
    name: Annotated[str, typer.Option(help="Name of the submission: a-z, 0-9, '.', '_', '-'.")],
    training_steps: Annotated[
        int,
        about_option(
            metavar="N",
            min=0,
            help="Control steps of a whole training, all phases and tasks; 0 if none.",
        ),
    ],
    training_seeds: Annotated[
        str | None,
        about_option(
            metavar="N,N",
            help="Seed of each training, in the order of the runs; by default 0, 1, ….",
        ),
    ] = None,
    method: Annotated[
        str | None,
        about_option(help="Name of the method on the leaderboard; by default NAME."),
    ] = None,
    authors: Annotated[str | None, about_option(help="Names, separated by commas.")] = None,
    paper: Annotated[str, about_option(help="An https link.")] = "",
    code: Annotated[str, about_option(help="An https link.")] = "",
    license_: Annotated[
        str, about_option("--license", help="SPDX expression, such as Apache-2.0.")
    ] = "",
    modalities: Annotated[
        str | None,
        about_option(
            help="What the policy uses: vision, and touch or proprioception (touch without its "
            "forces), separated by commas; by default vision,touch."
        ),
    ] = None,
    notes: Annotated[str, about_option(help="Anything else, on one line.")] = "",
    directory: Annotated[Path, output_option(help="Directory of all submissions.")] = SUBMISSIONS,
    include_checkpoint: Annotated[
        bool,
        output_option(help="Copy the checkpoint, or name its address on the Hub, to run it again."),
    ] = True,
) -> None:
    """Pack finished official runs as a submission for the leaderboard.

    The runs of one policy are one training of the method: one of table4, and at most one of
    novel-shapes. Give the runs of several trainings together. A submission that fails the check,
    or has the name of another, is not written.
    """
    from minitouch_bench.leaderboard.packing import group_by_training, pack
    from minitouch_bench.leaderboard.submission import Submission, check_submission
    from minitouch_bench.leaderboard.validation import RESERVED_MODALITIES
    from minitouch_bench.runs.run import read_run

    opened = [read_run(run) for run in runs]
    trainings = group_by_training(opened, include=include_checkpoint)
    seeds = whole_numbers("--training-seeds", training_seeds) or range(len(trainings))
    if len(seeds) != len(trainings):
        raise UsageError(
            f"the runs are of {len(trainings)} trainings, --training-seeds has {len(seeds)} numbers"
        )
    kind = opened[0].header.policy.kind
    submission = Submission(
        name=name,
        method=name if method is None else method,
        authors=words(authors),
        paper=paper,
        code=code,
        license=license_,
        training_steps=training_steps,
        modalities=words(modalities) or RESERVED_MODALITIES.get(kind, DEFAULT_MODALITIES),
        notes=notes,
        seeds=tuple(training.entry(seed) for seed, training in zip(seeds, trainings, strict=True)),
    )
    check_submission(submission)
    for seed in submission.seeds if include_checkpoint else ():
        for file in seed.checkpoints:
            if file.is_reference:
                note(f"{file.file} is not copied: the submission names {file.path}")
            elif not file.path:
                note(f"{file.file} is not there any more: only its SHA-256 is kept")
    if problems := pack(submission, trainings, directory):
        print_problems(name, problems)
        raise typer.Exit(CHECK_FAILED)
    place = directory / name
    print(place)
    note(
        f"valid; next: minitouch-bench leaderboard validate {place} --prove, "
        "then minitouch-bench leaderboard build"
    )
