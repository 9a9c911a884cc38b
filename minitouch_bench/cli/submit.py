"""``minitouch-bench submit``: evaluate a policy on the official suites and pack the submission."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli.console import EpisodeProgress, notes
from minitouch_bench.errors import UsageError
from minitouch_bench.workflows import options

INVALID = 1
about_option = partial(typer.Option, rich_help_panel="What the board tells")


def submit(
    policy: Annotated[
        str | None, typer.Argument(metavar="POLICY", help="As in evaluate; not with --run.")
    ] = None,
    *,
    name: Annotated[
        str | None,
        typer.Option(help="Name of the submission: a-z, 0-9, '.', '_', '-'; by default POLICY's."),
    ] = None,
    run: Annotated[
        list[Path] | None,
        typer.Option(
            "--run", metavar="DIR", help="Pack this finished run instead; one of each suite."
        ),
    ] = None,
    suites: Annotated[
        str, options.episodes_option(help="table4, or table4,novel-shapes.")
    ] = "table4",
    exploration: options.ExplorationText = None,
    training_seed: Annotated[
        int, about_option(min=0, help="Which training run this is; submit each under its own.")
    ] = 0,
    training_steps: Annotated[
        int | None, about_option(min=0, help="Control steps of the whole training.")
    ] = None,
    method: Annotated[str | None, about_option(help="What the board calls it.")] = None,
    authors: Annotated[str | None, about_option(help="Separated by commas.")] = None,
    paper: Annotated[str | None, about_option(help="An https link.")] = None,
    code: Annotated[str | None, about_option(help="An https link.")] = None,
    license_: Annotated[
        str | None, about_option("--license", help="SPDX, such as Apache-2.0.")
    ] = None,
    modalities: Annotated[
        str | None, about_option(help="vision, touch, or both, separated by commas.")
    ] = None,
    remarks: Annotated[str | None, about_option("--notes", help="Anything else.")] = None,
    directory: Annotated[Path, options.output_option(help="Where submissions are.")] = Path(
        "submissions"
    ),
    include_checkpoint: Annotated[
        bool, options.output_option(help="Copy the checkpoint, so that it can be run again.")
    ] = True,
    resume: options.Resume = False,
    fresh: options.Fresh = False,
    workers: options.WorkersText = options.AUTO,
    trust: options.Trust = False,
) -> None:
    """Evaluate a policy on the official suites and pack a submission for the leaderboard."""
    from minitouch_bench.workflows import submit as workflow

    given = {
        "method": method,
        "authors": None if authors is None else options.words(authors),
        "paper": paper,
        "code": code,
        "license": license_,
        "training_steps": training_steps,
        "modalities": None if modalities is None else _modalities(modalities),
        "notes": remarks,
    }
    if name is None:
        if policy is None:
            raise UsageError("say with --name what the submission is called")
        name = Path(policy).stem
    asked = workflow.SubmitOptions(
        name,
        policy=policy,
        runs=tuple(run or ()),
        exploration=exploration,
        suites=options.words(suites),
        about={field: value for field, value in given.items() if value is not None},
        training_seed=training_seed,
        include=include_checkpoint,
        directory=directory,
        engine=options.engine_options("local", workers, None),
        trust=trust,
        resume=resume,
        fresh=fresh,
    )
    with EpisodeProgress(notes) as progress:
        packed = workflow.submit(asked, progress.callbacks)
    for problem in packed.problems:
        print(f"{name}: {problem}")
    if packed.problems:
        raise typer.Exit(INVALID)
    print(packed.directory)
    notes.print(
        f"valid; next: minitouch-bench leaderboard validate {packed.directory} --replay, "
        "then minitouch-bench leaderboard build",
        markup=False,
    )


def _modalities(text: str) -> tuple[str, ...]:
    from minitouch_bench.leaderboard.submission import MODALITIES

    asked = options.words(text)
    if unknown := [word for word in asked if word not in MODALITIES]:
        raise UsageError(f"no modality '{unknown[0]}'; they are {', '.join(MODALITIES)}")
    return tuple(name for name in MODALITIES if name in asked)
