"""Evaluate a policy on the official suites, or take finished runs, and pack a submission."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from minitouch_bench.agents.config import trained_steps
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.evaluation.actors import PolicySetup, prepare_policies
from minitouch_bench.evaluation.engine import LOCAL, Engine, EngineOptions, open_engine
from minitouch_bench.evaluation.run import RunRequest, open_run
from minitouch_bench.files import (
    CHECKPOINTS,
    RUN_FILE,
    foreign_entries,
    holds_run,
    is_folder,
    lock_directory,
    os_errors_as,
    read_file,
)
from minitouch_bench.leaderboard.inventory import MAX_CHECKPOINT
from minitouch_bench.leaderboard.packing import (
    Parts,
    add_seed,
    aside,
    begun_submission,
    check_submission,
    check_submittable,
    copy_run,
    find_source,
    swap,
    with_seed,
)
from minitouch_bench.leaderboard.submission import (
    SUBMITTED_SUITES,
    Submission,
    TrainingSeed,
    run_place,
)
from minitouch_bench.leaderboard.submission_rules import check_name
from minitouch_bench.leaderboard.validation import (
    RESERVED_MODALITIES,
    check_copies,
    check_planned,
    validate,
)
from minitouch_bench.policies.isolation.options import IsolationOptions
from minitouch_bench.processes import interrupts_held
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.runs.run import Run, RunHeader, read_run
from minitouch_bench.verification.problems import Problem, Problems
from minitouch_bench.workflows import SILENT, Callbacks
from minitouch_bench.workflows.playing import play

DEFAULT_MODALITIES = ("vision", "touch")


@dataclass(frozen=True)
class SubmitOptions:
    """What to submit: a policy to evaluate, or the directories of finished runs.

    ``about`` holds fields of ``Submission``; what is left out stays as the submission has it.
    ``training_seed`` names the training run that the policy comes from. With ``include`` the
    checkpoint is copied, so that others can run it again. ``directory`` holds all submissions.
    """

    name: str
    policy: str | None = None
    runs: tuple[Path, ...] = ()
    exploration: str | None = None
    suites: tuple[str, ...] = (MAIN_SUITE,)
    about: Mapping[str, Any] = field(default_factory=dict)
    training_seed: int = 0
    include: bool = True
    directory: Path = Path("submissions")
    engine: EngineOptions = LOCAL
    trust: bool = False
    resume: bool = False
    fresh: bool = False


@dataclass(frozen=True)
class Packed:
    """A submission's directory, and the problems for which a maintainer would refuse it."""

    directory: Path
    problems: tuple[Problem, ...]


def submit(options: SubmitOptions, callbacks: Callbacks = SILENT) -> Packed:
    """Add a training seed to a submission, which begins with its first one, and check it.

    Raises:
        UsageError: an option has no meaning, or a run is not official.
        PolicyError, IsolationError, MissingExtraError: the policy cannot be used.
        RunDirectoryError: a run is there already, or cannot be read or written.
        InfrastructureError, InterruptedRunError: a run is incomplete and can be resumed.
    """
    check_name(options.name)
    if MAIN_SUITE not in options.suites or {*options.suites} - {*SUBMITTED_SUITES}:
        known, given = ",".join(SUBMITTED_SUITES), ",".join(options.suites)
        raise UsageError(f"--suites is {MAIN_SUITE}, or {known}, not '{given}'")
    directory = options.directory / options.name
    about = _about(options, begun_submission(directory))
    check_submission(about)
    if (options.policy is None) == (not options.runs):
        raise UsageError("give a POLICY to evaluate, or finished runs with --run")
    _check_apart(options, directory)
    packer = _Packer(options, directory, about, callbacks)
    parts = packer.finished_runs() if options.policy is None else packer.evaluate(options.policy)
    return packer.pack(parts)


def _check_apart(options: SubmitOptions, directory: Path) -> None:
    """Refuse a source in the submission, which is replaced, and a submission in a source."""
    there = directory.resolve()
    for named in (options.policy, options.exploration, *options.runs):
        path = Path(named or "").resolve()
        if named and path.exists() and (path.is_relative_to(there) or there.is_relative_to(path)):
            raise UsageError(
                f"{named} and the submission {directory} lie one in the other: "
                "copy the source elsewhere, or choose another --directory"
            )


def _about(options: SubmitOptions, begun: Submission | None) -> Submission:
    """Return what the submission says: what it said before, changed by the options given."""
    usual = RESERVED_MODALITIES.get(options.policy or options.name, DEFAULT_MODALITIES)
    steps = trained_steps(Path(options.policy)) if options.policy else 0
    known = begun or Submission(
        name=options.name, method=options.name, modalities=usual, training_steps=steps
    )
    return replace(known, name=options.name, **options.about)


@dataclass(frozen=True)
class _Packer:
    """Fills the runs and the checkpoints of one training seed into a submission."""

    options: SubmitOptions
    directory: Path
    about: Submission
    callbacks: Callbacks

    def evaluate(self, policy: str) -> Parts:
        """Run the suites in the submission's directory, where they can be resumed."""
        options = self.options
        opening = open_engine(options.engine, self.callbacks.note)
        setup = prepare_policies(
            policy,
            make_plan(MAIN_SUITE),
            IsolationOptions(trust=options.trust),
            self.callbacks.note,
            exploration=options.exploration,
        )
        requests = [_request(name, setup) for name in SUBMITTED_SUITES if name in options.suites]
        runs = {request.plan.suite: self._run_directory(request.plan.suite) for request in requests}
        parts = Parts(runs, setup.policy, setup.exploration)
        self._check_plan(parts, [request.header() for request in requests])
        for request in requests:
            self._check_kept(request)
        with opening as engine:
            for request in requests:
                self._run_suite(request, engine)
        return parts

    def finished_runs(self) -> Parts:
        """Look at finished runs, and find their policies."""
        paths = self.options.runs
        runs = [read_run(path) for path in paths]
        by_suite = {run.plan.suite: (run, path) for run, path in zip(runs, paths, strict=True)}
        if MAIN_SUITE not in by_suite or len(by_suite) != len(runs):
            raise UsageError(f"--run needs one run of {MAIN_SUITE}, and at most one of each suite")
        main = by_suite[MAIN_SUITE][0].header
        for suite, (run, path) in by_suite.items():
            check_submittable(run.header, path, main.policy)
            directory = self._run_directory(suite)
            if holds_run(directory) and not self.options.fresh:
                raise RunDirectoryError(f"{directory} holds a run.\nAdd --fresh to replace it")
        explorer = None if main.exploration is None else find_source(main.exploration)
        listed = {suite: by_suite[suite][1] for suite in SUBMITTED_SUITES if suite in by_suite}
        parts = Parts(listed, find_source(main.policy), explorer)
        self._check_replaced(parts)
        return parts

    def pack(self, parts: Parts) -> Packed:
        """Copy the parts aside and check them; only if they pass, replace those that were there."""
        options = self.options
        with aside(options.directory) as folder:
            copy = folder / "new" / options.name
            entry = self._entry(parts, copy, include=options.include)
            for suite, run in parts.runs.items():
                copy_run(run, copy / entry.runs[suite])
            for target in parts.gone() if options.include else ():
                self.callbacks.note(f"{target} is gone: only its SHA-256 is kept")
            add_seed(copy, None, self.about, entry)
            verdict = validate(copy)
            if problems := verdict.problems or self._copies(verdict.runs, entry):
                return Packed(self.directory, problems)
            with interrupts_held():
                for place in (*entry.runs.values(), f"{CHECKPOINTS}/seed-{entry.seed}"):
                    swap(copy / place, self.directory / place, folder / "old" / place)
                add_seed(self.directory, begun_submission(self.directory), self.about, entry)
        return Packed(self.directory, validate(self.directory).problems)

    def _entry(self, parts: Parts, directory: Path, *, include: bool) -> TrainingSeed:
        """Return what ``submission.toml`` says of the seed; ``include`` copies checkpoints."""
        seed = self.options.training_seed
        places = {suite: run_place(seed, suite) for suite in parts.runs}
        return TrainingSeed(seed, places, parts.name_files(directory, seed, include=include))

    def _copies(self, runs: Mapping[str, Run], entry: TrainingSeed) -> tuple[Problem, ...]:
        """Return a problem for each run that is another training seed's."""
        begun, problems = begun_submission(self.directory), Problems()
        others = {
            place: read_run(self.directory / place)
            for other in (begun.seeds if begun else ())
            if other.seed != entry.seed
            for place in other.runs.values()
        }
        check_copies({**others, **runs}, problems)
        return tuple(problems)

    def _check_plan(self, parts: Parts, headers: Sequence[RunHeader]) -> None:
        """Refuse before the first episode what would be refused after the last one."""
        self._check_replaced(parts)
        entry = self._entry(parts, self.directory, include=False)
        whole = with_seed(begun_submission(self.directory), self.about, entry)
        for problem in check_planned(whole, entry, headers, self.directory):
            raise UsageError(str(problem))

    def _check_replaced(self, parts: Parts) -> None:
        """Refuse to replace files that are not a run's, or the only copy of a checkpoint.

        Raises:
            RunDirectoryError: naming the first one.
        """
        for directory in map(self._run_directory, parts.runs):
            if foreign := foreign_entries(directory):
                raise RunDirectoryError(
                    f"{directory} holds {foreign[0]!a}, which is no file of a run: move it away"
                )
        old = self.directory / CHECKPOINTS / f"seed-{self.options.training_seed}"
        # What is included is copied before anything is replaced.
        elsewhere = parts.digests_there(None if self.options.include else old)
        for path in sorted(path for path in old.rglob("*") if not is_folder(path)):
            with os_errors_as(RunDirectoryError, path, "read"):
                digest = hashlib.sha256(read_file(path, MAX_CHECKPOINT)).hexdigest()
            if digest not in elsewhere:
                raise RunDirectoryError(
                    f"{path} would be replaced, and no other copy of it is known.\n"
                    "Move it away first, or choose another --training-seed"
                )

    def _run_directory(self, suite: str) -> Path:
        return self.directory / run_place(self.options.training_seed, suite)

    def _run_suite(self, request: RunRequest, engine: Engine) -> None:
        """Run one suite alone in its directory, or keep the finished run that is there."""
        options, directory = self.options, self._run_directory(request.plan.suite)
        with lock_directory(directory):
            if _is_finished(directory) and not options.fresh:
                return
            opened = open_run(request, directory, resume=options.resume, fresh=options.fresh)
            self.callbacks.note(f"suite {request.plan.suite}")
            play(request, opened, engine, self.callbacks)

    def _check_kept(self, request: RunRequest) -> None:
        """Refuse to keep a run that nobody asked to keep, or that is another one."""
        options, directory = self.options, self._run_directory(request.plan.suite)
        if options.fresh or not holds_run(directory):
            return
        if not _is_finished(directory):
            with lock_directory(directory):
                open_run(request, directory, resume=options.resume, fresh=False)
        elif not options.resume:
            raise RunDirectoryError(
                f"{directory} holds a finished run.\nAdd --resume to keep it, --fresh to replace "
                "it, or another --training-seed"
            )
        elif read_run(directory).header != request.header():
            raise RunDirectoryError(f"{directory} holds another policy's run; --fresh replaces it")


def _request(name: str, setup: PolicySetup) -> RunRequest:
    # The exploration metric is one of Table 4 alone.
    setup = setup if name == MAIN_SUITE else replace(setup, exploration=None)
    return RunRequest(make_plan(name), setup)


def _is_finished(directory: Path) -> bool:
    return (directory / RUN_FILE).exists()
