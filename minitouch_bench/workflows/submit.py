"""Evaluate a policy on the official suites, or take finished runs, and pack a submission."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from minitouch_bench.errors import UsageError
from minitouch_bench.files import SUBMISSIONS
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.workflows import SILENT, Callbacks, options
from minitouch_bench.workflows.options import StrPath, Words, episodes_option, output_option

if TYPE_CHECKING:
    from minitouch_bench.workflows.submitting import Packed

about_option = partial(typer.Option, rich_help_panel="What the leaderboard shows")
DEFAULT_MODALITIES = ("vision", "touch")


def submit(
    policy: Annotated[str | None, typer.Argument(metavar="POLICY")] = None,
    *,
    name: Annotated[str | None, typer.Option()] = None,
    runs: Annotated[Sequence[StrPath], typer.Option("--run", metavar="DIR")] = (),
    suites: Annotated[Words, episodes_option()] = MAIN_SUITE,
    exploration: Annotated[str | None, options.EXPLORATION] = None,
    training_seed: Annotated[int, about_option(min=0)] = 0,
    training_steps: Annotated[int | None, about_option(min=0)] = None,
    method: Annotated[str | None, about_option()] = None,
    authors: Annotated[Words | None, about_option()] = None,
    paper: Annotated[str | None, about_option()] = None,
    code: Annotated[str | None, about_option()] = None,
    license_: Annotated[str | None, about_option("--license")] = None,
    modalities: Annotated[Words | None, about_option()] = None,
    notes: Annotated[str | None, about_option()] = None,
    directory: Annotated[StrPath, output_option()] = SUBMISSIONS,
    include_checkpoint: Annotated[bool, output_option()] = True,
    resume: options.Resume = False,
    fresh: options.Fresh = False,
    workers: options.Workers = options.AUTO,
    trust: options.Trust = False,
    callbacks: Callbacks = SILENT,
) -> "Packed":
    """Evaluate a policy on the official suites and pack a submission for the leaderboard.

    It adds a training seed to the submission, which begins with its first one. What is said of
    the submission stays until an option changes it. Of a study's directory it packs every
    training seed of one method, without playing an episode again.

    Args:
        policy: As in evaluate, or a study's directory with --method; not with --run.
        name: Name of the submission: a-z, 0-9, '.', '_', '-'; by default POLICY's.
        runs: Pack this finished run instead; one of each suite.
        suites: table4, or table4,novel-shapes.
        training_seed: Number of the training; submit each training under its own number.
        training_steps: Control steps of the whole training.
        method: Name of the method on the leaderboard; of a study, which of its methods.
        authors: Names, separated by commas.
        paper: An https link.
        code: An https link.
        license_: SPDX expression, such as Apache-2.0.
        modalities: vision, touch, or both, separated by commas.
        notes: Anything else, on one line.
        directory: Directory of all submissions.
        include_checkpoint: Copy the checkpoint, so that others can run it again.

    Raises:
        UsageError: an option has no meaning, or a run is not official.
        PolicyError, IsolationError, MissingExtraError: the policy cannot be used.
        RunDirectoryError: a run is there already, or cannot be read or written.
        InfrastructureError, InterruptedRunError: a run is incomplete and can be resumed.
    """
    from minitouch_bench.agents.config import trained_steps
    from minitouch_bench.leaderboard.packing import begun_submission, check_submission
    from minitouch_bench.leaderboard.submission import SUBMITTED_SUITES, Submission
    from minitouch_bench.leaderboard.submission_rules import check_name
    from minitouch_bench.leaderboard.validation import RESERVED_MODALITIES
    from minitouch_bench.workflows.study_rows import find_study_row
    from minitouch_bench.workflows.submitting import Packer

    asked = options.words(suites)
    if MAIN_SUITE not in asked or {*asked} - {*SUBMITTED_SUITES}:
        known = ",".join(SUBMITTED_SUITES)
        raise UsageError(f"--suites is {MAIN_SUITE}, or {known}, not '{','.join(asked)}'")
    row = find_study_row(Path(policy), method, asked) if policy else None
    if row is not None and (exploration is not None or training_seed or resume):
        raise UsageError("a study has its own exploration policies and training seeds")
    if name is None:
        if policy is None:
            raise UsageError("say with --name what the submission is called")
        name = Path(policy).stem if row is None else row.method
    check_name(name)
    if row is not None and training_steps is None:
        training_steps = row.training_steps()
    given: dict[str, Any] = {
        "method": method,
        "authors": None if authors is None else options.words(authors),
        "paper": paper,
        "code": code,
        "license": license_,
        "training_steps": training_steps,
        "modalities": None if modalities is None else _modalities(modalities),
        "notes": notes,
    }
    begun = begun_submission(Path(directory) / name) or Submission(
        name=name,
        method=name,
        modalities=RESERVED_MODALITIES.get(policy or name, DEFAULT_MODALITIES),
        training_steps=trained_steps(Path(policy)) if policy else 0,
    )
    changes = {field: value for field, value in given.items() if value is not None}
    about = replace(begun, name=name, **changes)
    check_submission(about)
    if (policy is None) == (not runs):
        raise UsageError("give a POLICY to evaluate, or finished runs with --run")
    packer = Packer(
        Path(directory), about, training_seed, include_checkpoint, resume, fresh, callbacks
    )
    packer.check_apart((policy, exploration, *runs))
    if policy is None:
        return packer.pack(packer.finished_runs(tuple(map(Path, runs))))
    if row is not None:
        return packer.pack_study(row)
    isolation = options.isolation_options("sandbox", trust)
    engine = options.engine_options("local", workers, None)
    return packer.pack(packer.evaluate(policy, exploration, asked, isolation, engine))


def _modalities(given: Words) -> tuple[str, ...]:
    from minitouch_bench.leaderboard.submission import MODALITIES

    asked = options.words(given)
    if unknown := [word for word in asked if word not in MODALITIES]:
        raise UsageError(f"no modality '{unknown[0]}'; they are {', '.join(MODALITIES)}")
    return tuple(name for name in MODALITIES if name in asked)
