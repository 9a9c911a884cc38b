"""``minitouch-bench submit``: evaluate a policy on the official suites and pack the submission."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from minitouch_bench.cli.consoles import notes
from minitouch_bench.cli.contests import Holding, make_contest, worker_count
from minitouch_bench.cli.engines import Place
from minitouch_bench.cli.evaluate import run_episodes
from minitouch_bench.errors import PolicyLoadError, RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import Contest
from minitouch_bench.evaluation.evaluation import Request, begin
from minitouch_bench.evaluation.journal import JOURNAL_FILE
from minitouch_bench.evaluation.local_engine import LocalEngine
from minitouch_bench.evaluation.storage import LOCK_FILE, clear_run, lock_directory, write_actions
from minitouch_bench.evaluation.suites import find_suite
from minitouch_bench.leaderboard.packing import (
    add_seed,
    begun_submission,
    check_about,
    copy_run,
    name_files,
    tidy,
)
from minitouch_bench.leaderboard.submission import (
    MAIN_SUITE,
    MODALITIES,
    SUBMITTED_SUITES,
    About,
    CheckpointFile,
    Submission,
    TrainingSeed,
    run_place,
)
from minitouch_bench.leaderboard.texts import check_name
from minitouch_bench.leaderboard.validation import RESERVED_MODALITIES, validate
from minitouch_bench.metrics import summarize
from minitouch_bench.policies.isolation.levels import Isolation
from minitouch_bench.policies.process import PolicyLimits
from minitouch_bench.policies.sources import DIRECTORY, PolicySource, parse_source
from minitouch_bench.records import PolicyIdentity, Role, SavedRun
from minitouch_bench.reporting import read_run, write_run
from minitouch_bench.reporting.run_directory import RUN_FILE

INVALID = 1


def submit(
    policy: Annotated[
        str | None, typer.Argument(metavar="POLICY", help="As in evaluate; not with --run.")
    ] = None,
    *,
    name: Annotated[str, typer.Option(help="Name of the submission: a-z, 0-9, '.', '_', '-'.")],
    run: Annotated[
        list[Path] | None,
        typer.Option("--run", help="Pack this finished run instead; one of each suite."),
    ] = None,
    method: Annotated[str | None, typer.Option(help="What the board calls it.")] = None,
    authors: Annotated[str | None, typer.Option(help="Separated by commas.")] = None,
    paper: Annotated[str | None, typer.Option(help="An https link.")] = None,
    code: Annotated[str | None, typer.Option(help="An https link.")] = None,
    licence: Annotated[str | None, typer.Option(help="SPDX, such as Apache-2.0.")] = None,
    training_steps: Annotated[
        int | None, typer.Option(min=0, help="Control steps of the whole training.")
    ] = None,
    training_seed: Annotated[
        int, typer.Option(min=0, help="Which training run this is; submit each under its own.")
    ] = 0,
    modalities: Annotated[
        str | None, typer.Option(help="vision, touch, or both, separated by commas.")
    ] = None,
    remarks: Annotated[str | None, typer.Option("--notes", help="Anything else.")] = None,
    exploration: Annotated[
        str | None, typer.Option(help="The policy as of the end of the exploration phase.")
    ] = None,
    suites: Annotated[str, typer.Option(help="table4, or table4,novel-shapes.")] = MAIN_SUITE,
    include_checkpoint: Annotated[
        bool, typer.Option(help="Copy the checkpoint, so that it can be run again.")
    ] = True,
    directory: Annotated[Path, typer.Option(help="Where submissions are.")] = Path("submissions"),
    workers: Annotated[str, typer.Option(help="Worker processes, or auto: one a core.")] = "auto",
    resume: Annotated[bool, typer.Option("--resume", help="Continue where it stopped.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Replace this seed's runs.")] = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="Run a policy's own Python code on this machine.")
    ] = False,
) -> None:
    """Evaluate a policy on the official suites and pack a submission for the leaderboard."""
    check_name(name)
    place = directory / name
    begun = begun_submission(place)
    given = {
        "method": method,
        "authors": None if authors is None else tuple(_words(authors)),
        "paper": paper,
        "code": code,
        "licence": licence,
        "training_steps": training_steps,
        "modalities": None if modalities is None else _modalities(modalities),
        "notes": remarks,
    }
    about = _about(name, policy, begun, {k: v for k, v in given.items() if v is not None})
    check_about(about)
    job = _Job(place, training_seed, include_checkpoint, resume, fresh)
    if (policy is None) == (not run):
        raise UsageError("give a POLICY to evaluate, or finished runs with --run")
    if policy is not None:
        contest = _contest(policy, exploration, _suites(suites), trust)
        count = worker_count(workers)
        seed = _evaluate(job, contest, _suites(suites), Place(LocalEngine(count), count))
    else:
        seed = _pack(job, [read_run(path) for path in run or ()], run or ())
    add_seed(place, begun, about, seed)
    _check(place)


@dataclass(frozen=True)
class _Job:
    """Where a training seed's runs go, and what may be there already."""

    place: Path
    seed: int
    include: bool
    resume: bool
    fresh: bool


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _modalities(text: str) -> tuple[str, ...]:
    asked = _words(text)
    if unknown := [word for word in asked if word not in MODALITIES]:
        raise UsageError(f"no modality '{unknown[0]}'; they are {', '.join(MODALITIES)}")
    return tuple(name for name in MODALITIES if name in asked)


def _suites(text: str) -> tuple[str, ...]:
    asked = _words(text)
    if MAIN_SUITE not in asked or any(suite not in SUBMITTED_SUITES for suite in asked):
        raise UsageError(f"--suites is {MAIN_SUITE}, or {','.join(SUBMITTED_SUITES)}, not '{text}'")
    return tuple(suite for suite in SUBMITTED_SUITES if suite in asked)


def _about(
    name: str, policy: str | None, begun: Submission | None, given: dict[str, object]
) -> About:
    """Return what the submission tells: what it told before, changed by the options given."""
    usual = RESERVED_MODALITIES.get(policy or name, ("vision", "touch"))
    known = begun.about if begun else About(name, method=name, modalities=usual)
    return replace(known, name=name, **given)  # type: ignore[arg-type]


def _contest(policy: str, exploration: str | None, suites: Sequence[str], trust: bool) -> Contest:
    """Find and load the policies once for the tasks of every suite."""
    tasks = find_suite(suites[0]).tasks
    return make_contest(
        policy, exploration, tasks, Holding(PolicyLimits(), Isolation.SANDBOX, trust)
    )


def _evaluate(job: _Job, contest: Contest, suites: Sequence[str], engine: Place) -> TrainingSeed:
    """Run the suites into the submission, and return the entry of the training seed."""
    files = _files(job, contest.policy, contest.exploration)
    for name in suites:
        suite = find_suite(name)
        # The exploration figure is one of Table 4 alone.
        explorer = contest.exploration if name == MAIN_SUITE else None
        request = Request(
            suite,
            suite.tasks,
            suite.episodes_per_task,
            suite.seed,
            replace(contest, exploration=explorer),
        )
        _run_suite(job, request, job.place / run_place(job.seed, name), engine)
    return TrainingSeed(job.seed, {s: run_place(job.seed, s) for s in suites}, files)


def _run_suite(job: _Job, request: Request, place: Path, engine: Place) -> None:
    """Run one suite alone in its directory, and leave no lock in what is then packed."""
    with lock_directory(place):
        try:
            _fill(job, request, place, engine)
        finally:
            (place / LOCK_FILE).unlink(missing_ok=True)


def _fill(job: _Job, request: Request, place: Path, engine: Place) -> None:
    """Run one suite, or what is missing of it; a finished run is kept or replaced as asked."""
    finished = (place / RUN_FILE).exists() and not (place / JOURNAL_FILE).exists()
    if finished and not job.fresh:
        _check_kept(job, request, place)
        return
    if job.fresh:
        clear_run(place)
    begun = begin(request, place, resume=job.resume, fresh=False)
    notes.print(f"suite {request.suite.name}", markup=False)
    run = run_episodes(request, begun, place, engine)
    write_actions(run.records, place)
    write_run(run, summarize(run, np.random.default_rng(run.header.seed)), place)
    tidy(place)


def _check_kept(job: _Job, request: Request, place: Path) -> None:
    """Refuse to keep a finished run that nobody asked to keep, or that is another one."""
    if not job.resume:
        raise RunDirectoryError(
            f"{place} holds a finished run.\nAdd --resume to keep it, --fresh to replace it, or "
            "another --training-seed"
        )
    if read_run(place).header != request.header():
        raise RunDirectoryError(f"{place} holds the run of another policy; --fresh replaces it")


def _pack(job: _Job, saved: Sequence[SavedRun], paths: Sequence[Path]) -> TrainingSeed:
    """Copy finished runs into the submission, and return the entry of the training seed."""
    by_suite = {run.header.suite: (run, path) for run, path in zip(saved, paths, strict=True)}
    if MAIN_SUITE not in by_suite or len(by_suite) != len(saved):
        raise UsageError(f"--run needs one run of {MAIN_SUITE}, and at most one of each suite")
    for run, path in by_suite.values():
        if run.header.suite not in SUBMITTED_SUITES or not run.header.official:
            reasons = "; ".join(run.header.unofficial_because) or f"suite {run.header.suite}"
            raise UsageError(f"{path} is no official run: {reasons}")
    main = by_suite[MAIN_SUITE][0].header
    for suite, (run, path) in by_suite.items():
        if (run.header.policy.kind, run.header.policy.digest) != (
            main.policy.kind,
            main.policy.digest,
        ):
            raise UsageError(f"{path} is the run of another policy than that of {MAIN_SUITE}")
        place = job.place / run_place(job.seed, suite)
        if (place / RUN_FILE).exists() and not job.fresh:
            raise RunDirectoryError(f"{place} holds a run.\nAdd --fresh to replace it")
        clear_run(place)
        copy_run(path, place)
    exploration = None if main.exploration is None else _source_of(main.exploration)
    files = _files(job, _source_of(main.policy), exploration)
    return TrainingSeed(
        job.seed, {s: run_place(job.seed, s) for s in SUBMITTED_SUITES if s in by_suite}, files
    )


def _source_of(recorded: PolicyIdentity) -> PolicySource:
    """Find the policy of a finished run again, or what is known of it where it is gone.

    Raises:
        UsageError: it is a directory, which is known by its files alone.
    """
    try:
        source = parse_source(recorded.source, trust=True)
        if (source.kind, source.digest) == (recorded.kind, recorded.digest):
            return source
    except PolicyLoadError:
        pass
    if recorded.kind == DIRECTORY:
        raise UsageError(f"the policy {recorded.source} has changed or is gone: put it back")
    return PolicySource(recorded.kind, recorded.name, recorded.source, recorded.digest)


def _files(
    job: _Job, policy: PolicySource, exploration: PolicySource | None
) -> tuple[CheckpointFile, ...]:
    """Name the checkpoint files of both roles, and copy them if asked for."""
    files: list[CheckpointFile] = []
    for role, source in ((Role.FINAL, policy), (Role.EXPLORATION, exploration)):
        if source is not None:
            there = not source.digest or Path(source.target).exists()
            if job.include and not there:
                notes.print(f"{source.target} is gone: only its SHA-256 is kept", markup=False)
            files += name_files(job.place, source, role, job.seed, include=job.include and there)
    return tuple(files)


def _check(place: Path) -> None:
    """Check the finished submission as a maintainer will, and say what comes next."""
    verdict = validate(place)
    for fault in verdict.faults:
        print(f"{place.name}: {fault}")
    if not verdict.passed:
        raise typer.Exit(INVALID)
    print(place)
    notes.print(
        f"valid; next: minitouch-bench leaderboard validate {place} --replay, "
        "then minitouch-bench leaderboard build",
        markup=False,
    )
