"""Plays a submission's episodes again, and new ones, and notes every difference."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from minitouch_bench.errors import IncompleteCheckError
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.engine import Engine
from minitouch_bench.files import CHECKPOINTS
from minitouch_bench.leaderboard.proof import FreshProof
from minitouch_bench.leaderboard.submission import TrainingSeed
from minitouch_bench.leaderboard.validation import Verdict
from minitouch_bench.metrics.summary import measure
from minitouch_bench.policies.loaders import BUILT_IN
from minitouch_bench.policies.sources import DIRECTORY, PolicySource, parse_source
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.records import (
    EpisodeMetrics,
    EpisodeRecord,
    EpisodeSpec,
    Outcome,
    PolicyIdentity,
    Role,
)
from minitouch_bench.runs.run import Run
from minitouch_bench.verification.fresh import (
    FreshResult,
    Values,
    compare_fresh,
    drop_together,
    fresh_seed,
    significant_drops,
)
from minitouch_bench.verification.problems import Problem, Problems
from minitouch_bench.verification.verify import draw_episodes, prepare_rerun, replay_run, rerun
from minitouch_bench.workflows import ignore

NOT_REPLAYED = "the recorded actions do not give these values"
NOT_REPEATED = "the checkpoint does not act as recorded"
FITS_OFFICIAL = "the checkpoint fits the official episodes"


def fresh_specs(run: Run, count: int, seed: int) -> tuple[EpisodeSpec, ...]:
    """Return ``count`` episodes of each task of a run, with another seed."""
    plan = replace(run.plan, episodes=count, seed=seed, chosen=())
    return plan.specs(exploration=run.header.exploration is not None)


def _drop_problem(place: str, drop: FreshResult) -> Problem:
    what = (
        f"{drop.metric} {drop.official:.3f} officially, {drop.fresh:.3f} in "
        f"{drop.episodes} fresh episodes (p = {drop.p:.2g})"
    )
    return Problem(f"{place}, {drop.role} {drop.task}", what, FITS_OFFICIAL)


@dataclass(frozen=True)
class Prover:
    """Plays the episodes that prove a submission; each difference is added to ``problems``.

    ``rng`` draws those that are run again; ``on_record`` takes each episode that was played.
    """

    verdict: Verdict
    engine: Engine
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    on_record: Callable[[EpisodeRecord], None] = ignore
    problems: Problems = field(default_factory=Problems)

    def replay(self) -> None:
        """Replay the actions of every run. No checkpoint is opened."""
        for place, run in self.verdict.runs.items():
            with self.problems.caught(place):
                for problem in replay_run(run, self.engine, self.on_record).problems:
                    self.problems.add_below(place, replace(problem, remedy=NOT_REPLAYED))

    def run_again(self, count: int) -> None:
        """Run ``count`` drawn episodes of each policy of each run, held in the sandbox.

        Raises:
            IncompleteCheckError: the policy fails here and did not there, or the other way round,
                as on a slower machine.
        """
        failed = []
        for seed in self.verdict.submission.seeds:
            for place in seed.runs.values():
                with self.problems.caught(place):
                    run = self.verdict.runs[place]
                    specs = draw_episodes(run, count, self.rng)
                    setup, rows = self._setup(seed, run), dict(run.rows())
                    for record, differing in rerun(run, setup, specs, self.engine):
                        self.on_record(record)
                        faults = (record.outcome, rows[record.spec].outcome)
                        if differing and Outcome.POLICY_FAULT in faults:
                            what = record.fault or "the recorded one"
                            failed.append(f"{place}, {record.spec.key}: {what}")
                            continue
                        for problem in differing:
                            self.problems.add_below(place, replace(problem, remedy=NOT_REPEATED))
        if failed:
            raise IncompleteCheckError(
                f"{len(failed)} episodes end by a policy fault in only one of both runs; "
                f"the first: {failed[0]}"
            )

    def run_fresh(self, count: int, draw: str) -> FreshProof:
        """Run ``count`` new episodes of each task of each run, and compare with the official ones.

        A significant drop is a problem. An episode that ends by a policy fault is a failed one; to
        find a machine that is too slow, call ``run_again`` first. On novel shapes they are the
        first ``count`` of the suite: its shapes in its order, in new scenes.
        """
        seeds: dict[str, int] = {}
        played: dict[str, dict[tuple[Role, str], Values]] = {}
        faults: list[str] = []
        try:
            for seed in self.verdict.submission.seeds:
                for place in seed.runs.values():
                    with self.problems.caught(place):
                        run = self.verdict.runs[place]
                        seeds[place] = fresh_seed(run.header.policy.digest, draw)
                        specs = fresh_specs(run, count, seeds[place])
                        played[place], failed = self._play_fresh(run, self._setup(seed, run), specs)
                        faults += (f"{place}, {fault}" for fault in failed)
        finally:  # also where the time is up before the last run
            results = {
                place: tuple(compare_fresh(one, *key) for key, one in values.items())
                for place, values in played.items()
            }
            drops = [] if self.problems else self._drops(results, played)
            if drops and faults:
                what = f"{len(faults)} fresh episodes end by a policy fault; the first: {faults[0]}"
                drops.append(Problem("", what, "a fault is a failed episode, as in every run"))
            for drop in drops:
                self.problems.add(drop.place, drop.what, drop.remedy)
        return FreshProof(draw, count, seeds, results)

    def _play_fresh(
        self, run: Run, setup: PolicySetup, specs: Sequence[EpisodeSpec]
    ) -> tuple[dict[tuple[Role, str], Values], list[str]]:
        """Play fresh episodes; return by role and task what ranks, and the policy's faults."""
        fresh: dict[tuple[Role, str], list[EpisodeMetrics]] = {}
        faults = []
        for record in self.engine.run(setup, specs):
            self.on_record(record)
            fresh.setdefault((record.spec.role, record.spec.task), []).append(measure(record))
            if record.fault:
                faults.append(f"{record.spec.key}: {record.fault}")
        official = dict(run.by_role())
        values = {
            (role, task): Values.of(task, [row for row in official[role] if row.task == task], rows)
            for (role, task), rows in fresh.items()
        }
        return values, faults

    def _drops(
        self,
        results: Mapping[str, Sequence[FreshResult]],
        played: Mapping[str, Mapping[tuple[Role, str], Values]],
    ) -> list[Problem]:
        """Return the drops that an honest submission would hardly have."""
        policies = {
            (place, spec.role, spec.task)
            for place, run in self.verdict.runs.items()
            for spec in run.header.specs()
        }
        drops = [
            _drop_problem(place, drop)
            for place, compared in results.items()
            for drop in significant_drops(compared, planned=len(policies))
        ]
        ranked: dict[str, list[Values]] = {}
        for seed in self.verdict.submission.seeds:
            for (role, task), values in played.get(seed.runs.get(MAIN_SUITE, ""), {}).items():
                if role is Role.FINAL:
                    ranked.setdefault(task, []).append(values)
        if ranked and not drops and (p := drop_together(ranked.values())) is not None:
            what = f"fresh episodes are worse over the tasks and training seeds (p = {p:.2g})"
            drops.append(Problem("", what, FITS_OFFICIAL))
        return drops

    def _setup(self, seed: TrainingSeed, run: Run) -> PolicySetup:
        header = run.header
        explorer = header.exploration and self._source(seed, Role.EXPLORATION, header.exploration)
        return prepare_rerun(run, self._source(seed, Role.FINAL, header.policy), explorer)

    def _source(self, seed: TrainingSeed, role: Role, recorded: PolicyIdentity) -> PolicySource:
        """Find a policy's checkpoint in the submission.

        Raises:
            IncompleteCheckError: it is not there.
            PolicyLoadError: it cannot be read.
        """
        files = seed.files(role)
        if recorded.kind in BUILT_IN:
            return parse_source(recorded.kind)
        if not files or not all(file.path for file in files):
            raise IncompleteCheckError(
                f"the {role} checkpoint of seed {seed.seed} is not in the submission: "
                "it cannot be run again"
            )
        path = self.verdict.directory / files[0].path
        if recorded.kind == DIRECTORY:
            path = self.verdict.directory / CHECKPOINTS / f"seed-{seed.seed}" / role.value
        return parse_source(str(path))
