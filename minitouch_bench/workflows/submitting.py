"""Fill the runs and the checkpoints of one training seed into a submission, and check it."""

import hashlib
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.evaluation.actors import PolicySetup, prepare_policies
from minitouch_bench.evaluation.engine import Engine, EngineOptions, open_engine
from minitouch_bench.evaluation.run import header_of, open_run
from minitouch_bench.files import (
    CHECKPOINTS,
    LARGEST_CHECKPOINT,
    foreign_entries,
    holds_run,
    is_folder,
    lock_directory,
    make_folder,
    os_errors_as,
    read_file,
)
from minitouch_bench.leaderboard import packing
from minitouch_bench.leaderboard.submission import (
    SUBMITTED_SUITES,
    Submission,
    TrainingSeed,
    run_place,
)
from minitouch_bench.leaderboard.validation import check_copies, check_planned, validate
from minitouch_bench.policies.isolation.options import IsolationOptions
from minitouch_bench.processes import interrupts_held
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.runs.run import Run, RunHeader, read_run
from minitouch_bench.verification.problems import Problem, Problems
from minitouch_bench.workflows import Callbacks
from minitouch_bench.workflows.options import StrPath
from minitouch_bench.workflows.playing import play
from minitouch_bench.workflows.study_rows import StudyRow


@dataclass(frozen=True)
class Packed:
    """A submission's directory, and the problems for which a maintainer would refuse it."""

    directory: Path
    problems: tuple[Problem, ...]


@dataclass(frozen=True)
class Packer:
    """Fills the runs and the checkpoints of one training seed into a submission.

    ``submissions`` is the directory of all submissions; ``about`` describes this one. ``seed``
    names the training run of the policy. With ``include`` the checkpoint is copied, so that others
    can run it again. ``resume`` continues a run in the submission, ``fresh`` replaces it.
    """

    submissions: Path
    about: Submission
    seed: int
    include: bool
    resume: bool
    fresh: bool
    callbacks: Callbacks

    @property
    def directory(self) -> Path:
        """The submission's directory."""
        return self.submissions / self.about.name

    def check_apart(self, sources: Iterable[StrPath | None]) -> None:
        """Refuse a source in the submission, which is replaced, and a submission in a source.

        Raises:
            UsageError: naming the first one.
        """
        there = Path(os.path.realpath(self.directory))
        for source in sources:
            path = Path(os.path.realpath(source or ""))
            is_apart = not (path.is_relative_to(there) or there.is_relative_to(path))
            if source and os.path.exists(path) and not is_apart:
                raise UsageError(
                    f"{source} and the submission {self.directory} lie one in the other: "
                    "copy the source elsewhere, or choose another --directory"
                )

    def evaluate(
        self,
        policy: str,
        exploration: str | None,
        suites: Collection[str],
        isolation: IsolationOptions,
        engine: EngineOptions,
    ) -> packing.Parts:
        """Run the suites in the submission's directory, where they can be resumed."""
        opening = open_engine(engine, self.callbacks.note)
        main = prepare_policies(
            policy,
            make_plan(MAIN_SUITE),
            isolation,
            self.callbacks.note,
            exploration=exploration,
        )
        setups = [_on_suite(main, name) for name in SUBMITTED_SUITES if name in suites]
        runs = {setup.plan.suite: self._run_directory(setup.plan.suite) for setup in setups}
        parts = packing.Parts(runs, main.policy, main.exploration)
        self._check_plan(parts, [header_of(setup) for setup in setups])
        for setup in setups:
            self._check_kept(setup)
        with opening as running:
            for setup in setups:
                self._run_suite(setup, running)
        return parts

    def finished_runs(self, paths: Sequence[Path]) -> packing.Parts:
        """Look at finished runs, and find their policies."""
        runs = [read_run(path) for path in paths]
        by_suite = {run.plan.suite: (run, run.directory or Path()) for run in runs}
        if MAIN_SUITE not in by_suite or len(by_suite) != len(runs):
            raise UsageError(f"--run needs one run of {MAIN_SUITE}, and at most one of each suite")
        main = by_suite[MAIN_SUITE][0].header
        for suite, (run, path) in by_suite.items():
            packing.check_submittable(run.header, path, main.policy)
            directory = self._run_directory(suite)
            if holds_run(directory) and not self.fresh:
                raise RunDirectoryError(f"{directory} contains a run.\nAdd --fresh to replace it")
        explorer = None if main.exploration is None else packing.find_source(main.exploration)
        listed = {suite: by_suite[suite][1] for suite in SUBMITTED_SUITES if suite in by_suite}
        parts = packing.Parts(listed, packing.find_source(main.policy), explorer)
        self._check_replaced(parts)
        return parts

    def pack_study(self, row: StudyRow) -> Packed:
        """Pack every training seed of a study's method; with ``fresh`` in place of those there.

        Raises:
            RunDirectoryError: a submission of this name is there.
            UsageError: see ``StudyRow.parts``.
        """
        begun = packing.begun_submission(self.directory)
        if begun is not None and not self.fresh:
            raise RunDirectoryError(f"{self.directory} is there.\nAdd --fresh to replace it")
        for seed in begun.seeds if begun else ():
            if seed.seed not in row.trainings:
                raise RunDirectoryError(
                    f"{self.directory} has training seed {seed.seed}, which the study lacks.\n"
                    "Choose another --name"
                )
        with packing.aside(self.submissions) as folder:
            seeds = []
            for number in row.trainings:
                self.callbacks.note(f"training seed {number}")
                packer = replace(self, seed=number)
                parts = row.parts(number, make_folder(folder / str(number)), self.directory)
                packer._check_replaced(parts)
                seeds.append((packer, parts))
            return self._pack(seeds)

    def pack(self, parts: packing.Parts) -> Packed:
        """Copy the parts aside and check them; only if they pass, replace those that were there."""
        return self._pack([(self, parts)])

    def _pack(self, seeds: Sequence[tuple["Packer", packing.Parts]]) -> Packed:
        """Pack the parts of some training seeds, all or none of them."""
        with packing.aside(self.submissions) as folder:
            copy = folder / "new" / self.about.name
            entries = [packer._fill(copy, parts) for packer, parts in seeds]
            packing.add_seeds(copy, self.about, entries)
            verdict = validate(copy)
            if problems := verdict.problems or self._copies(verdict.runs, entries):
                return Packed(self.directory, problems)
            with lock_directory(self.submissions, wait=True), interrupts_held():
                for entry in entries:
                    for place in (*entry.runs.values(), f"{CHECKPOINTS}/seed-{entry.seed}"):
                        packing.swap(copy / place, self.directory / place, folder / "old" / place)
                packing.add_seeds(self.directory, self.about, entries)
                return Packed(self.directory, validate(self.directory).problems)

    def _fill(self, copy: Path, parts: packing.Parts) -> TrainingSeed:
        """Copy the runs and the checkpoints of this training seed."""
        entry = self._entry(parts, copy, include=self.include)
        for suite, run in parts.runs.items():
            packing.copy_run(run, copy / entry.runs[suite])
        for target in parts.gone() if self.include else ():
            self.callbacks.note(f"{target} is gone: only its SHA-256 is kept")
        return entry

    def _entry(self, parts: packing.Parts, directory: Path, *, include: bool) -> TrainingSeed:
        """Return what ``submission.toml`` says of the seed; ``include`` copies checkpoints."""
        places = {suite: run_place(self.seed, suite) for suite in parts.runs}
        files = parts.name_files(directory, self.seed, include=include)
        return TrainingSeed(self.seed, places, files)

    def _copies(
        self, runs: Mapping[str, Run], entries: Sequence[TrainingSeed]
    ) -> tuple[Problem, ...]:
        """Return a problem for each run that is another training seed's."""
        begun, problems = packing.begun_submission(self.directory), Problems()
        replaced = {entry.seed for entry in entries}
        others = {
            place: read_run(self.directory / place)
            for other in (begun.seeds if begun else ())
            if other.seed not in replaced
            for place in other.runs.values()
        }
        check_copies({**others, **runs}, problems)
        return tuple(problems)

    def _check_plan(self, parts: packing.Parts, headers: Sequence[RunHeader]) -> None:
        """Refuse before the first episode what would be refused after the last one."""
        self._check_replaced(parts)
        entry = self._entry(parts, self.directory, include=False)
        whole = packing.with_seeds(packing.begun_submission(self.directory), self.about, [entry])
        for problem in check_planned(whole, entry, headers, self.directory):
            raise UsageError(str(problem))

    def _check_replaced(self, parts: packing.Parts) -> None:
        """Refuse to replace files that are not a run's, or the only copy of a checkpoint.

        Raises:
            RunDirectoryError: naming the first one.
        """
        for directory in map(self._run_directory, parts.runs):
            if foreign := foreign_entries(directory):
                raise RunDirectoryError(
                    f"{directory} contains {foreign[0]!a}, which is not a file of a run: "
                    "move it away"
                )
        old = self.directory / CHECKPOINTS / f"seed-{self.seed}"
        # What is included is copied before anything is replaced.
        elsewhere = parts.digests_there(None if self.include else old)
        for path in sorted(path for path in old.rglob("*") if not is_folder(path)):
            with os_errors_as(RunDirectoryError, path, "read"):
                digest = hashlib.sha256(read_file(path, LARGEST_CHECKPOINT)).hexdigest()
            if digest not in elsewhere:
                raise RunDirectoryError(
                    f"{path} would be replaced, and no other copy of it is known.\n"
                    "Move it away first, or choose another --training-seed"
                )

    def _run_directory(self, suite: str) -> Path:
        return self.directory / run_place(self.seed, suite)

    def _run_suite(self, setup: PolicySetup, engine: Engine) -> None:
        """Run one suite in its directory, or keep the finished run that is there."""
        directory = self._run_directory(setup.plan.suite)
        with lock_directory(directory):
            opened = open_run(setup, directory, resume=self.resume, fresh=self.fresh)
            self.callbacks.note(f"suite {setup.plan.suite}")
            play(setup, opened, engine, self.callbacks)

    def _check_kept(self, setup: PolicySetup) -> None:
        """Refuse to keep a run that nobody asked to keep, or that is another one."""
        directory = self._run_directory(setup.plan.suite)
        if self.fresh or not holds_run(directory):
            return
        if not self.resume:
            raise RunDirectoryError(
                f"{directory} already contains a run.\nAdd --resume to keep it, --fresh to "
                "replace it, or another --training-seed"
            )
        with lock_directory(directory):
            open_run(setup, directory, resume=True, fresh=False)


def _on_suite(main: PolicySetup, name: str) -> PolicySetup:
    # The exploration metric is one of Table 4 alone.
    return main if name == MAIN_SUITE else replace(main, plan=make_plan(name), exploration=None)
