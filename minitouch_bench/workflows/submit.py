"""Pack finished runs as a submission."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.errors import UsageError
from minitouch_bench.files import SUBMISSIONS
from minitouch_bench.workflows import SILENT, Callbacks, options
from minitouch_bench.workflows.options import Numbers, StrPath, Words, output_option

if TYPE_CHECKING:
    from minitouch_bench.leaderboard.packing import Packed

about_option = partial(typer.Option, rich_help_panel="What the leaderboard shows")
DEFAULT_MODALITIES = ("vision", "touch")


def submit(
    *runs: Annotated[StrPath, typer.Argument(metavar="RUN", help="Official runs.")],
    name: Annotated[str, typer.Option()],
    training_steps: Annotated[int, about_option(min=0)],
    training_seeds: Annotated[Numbers | None, about_option(metavar="N,N")] = None,
    method: Annotated[str | None, about_option()] = None,
    authors: Annotated[Words | None, about_option()] = None,
    paper: Annotated[str, about_option()] = "",
    code: Annotated[str, about_option()] = "",
    license_: Annotated[str, about_option("--license")] = "",
    modalities: Annotated[Words | None, about_option()] = None,
    notes: Annotated[str, about_option()] = "",
    directory: Annotated[StrPath, output_option()] = SUBMISSIONS,
    include_checkpoint: Annotated[bool, output_option()] = True,
    callbacks: Callbacks = SILENT,
) -> "Packed":
    """Pack finished official runs as a submission for the leaderboard.

    The runs of one policy are one training of the method: one of table4, and at most one of
    novel-shapes. Give the runs of several trainings together. A submission that fails the check,
    or has the name of another, is not written.

    Args:
        name: Name of the submission: a-z, 0-9, '.', '_', '-'.
        training_steps: Control steps of a whole training, all phases and tasks; 0 of no training.
        training_seeds: Seed of each training, in the order of the runs; by default 0, 1, ….
        method: Name of the method on the leaderboard; by default NAME.
        authors: Names, separated by commas.
        paper: An https link.
        code: An https link.
        license_: SPDX expression, such as Apache-2.0.
        modalities: vision, touch, or both, separated by commas; by default both.
        notes: Anything else, on one line.
        directory: Directory of all submissions.
        include_checkpoint: Copy the checkpoint, so that others can run it again.

    Raises:
        UsageError: a run is not official, or an option has no such value.
        RunDirectoryError: the submission is there, or a file cannot be read or written.
    """
    from minitouch_bench.leaderboard.packing import Packed, group_by_training, pack
    from minitouch_bench.leaderboard.submission import Submission, check_submission
    from minitouch_bench.leaderboard.validation import RESERVED_MODALITIES
    from minitouch_bench.runs.run import read_run

    opened = [read_run(Path(run)) for run in runs]
    trainings = group_by_training(opened, include=include_checkpoint)
    seeds = options.whole_numbers("--training-seeds", training_seeds) or range(len(trainings))
    if len(seeds) != len(trainings):
        raise UsageError(
            f"the runs are of {len(trainings)} trainings, --training-seeds has {len(seeds)} numbers"
        )
    kind = opened[0].header.policy.kind
    submission = Submission(
        name=name,
        method=name if method is None else method,
        authors=options.words(authors),
        paper=paper,
        code=code,
        license=license_,
        training_steps=training_steps,
        modalities=options.words(modalities) or RESERVED_MODALITIES.get(kind, DEFAULT_MODALITIES),
        notes=notes,
        seeds=tuple(training.entry(seed) for seed, training in zip(seeds, trainings, strict=True)),
    )
    check_submission(submission)
    for seed in submission.seeds if include_checkpoint else ():
        for file in seed.checkpoints:
            if not file.path:
                callbacks.note(f"{file.file} is not there any more: only its SHA-256 is kept")
    directory = Path(directory)
    return Packed(directory / name, pack(submission, trainings, directory))
