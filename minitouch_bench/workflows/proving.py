"""Check one submission as a maintainer does, and write the proof of what was checked.

Its actions are replayed, and sampled and fresh episodes are run with its checkpoint.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from minitouch_bench.errors import IncompleteCheckError, MiniTouchError
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.engine import LOCAL, Engine, EngineOptions, open_engine
from minitouch_bench.files import CHECKPOINTS
from minitouch_bench.leaderboard.proof import (
    MIN_FRESH_EPISODES,
    PROOFS,
    PROVED_LEVELS,
    FreshProof,
    ProofLevel,
    find_proof,
    level_of,
    make_proof,
    proof_path,
    withdraw_proof,
    write_proof,
)
from minitouch_bench.leaderboard.submission import TrainingSeed
from minitouch_bench.leaderboard.validation import Verdict, validate
from minitouch_bench.metrics.summary import measure
from minitouch_bench.policies.formats import BUILT_IN
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
    new_draw,
    significant_drops,
)
from minitouch_bench.verification.problems import Problem, Problems
from minitouch_bench.verification.verify import draw_episodes, prepare_rerun, replay_run, rerun
from minitouch_bench.workflows import SILENT, Callbacks, ignore

RERUN_BEFORE_FRESH = 50
"""Drawn episodes of each policy of a run that are run before fresh ones, unless N is asked."""

TIME_LIMIT_S = 6 * 3600.0
"""How long the check of one submission may take: a policy may use minutes in each episode."""

MORE_FAULTS = 0.05
"""Share of policy faults among fresh episodes, above that of the official ones, from which nothing
is concluded: a slow machine gives them too."""

NOT_REPLAYED = "the recorded actions do not give these values"
NOT_REPEATED = "the checkpoint does not act as recorded"
FITS_OFFICIAL = "the checkpoint fits the official episodes"


@dataclass(frozen=True)
class Validation:
    """What a check of a submission found: problems, or where there are none the level of proof.

    ``withdrawn``: the level of an older proof that these problems end. ``error``: why the check
    could not be made or finished.
    """

    problems: tuple[Problem, ...]
    level: ProofLevel | None = None
    withdrawn: ProofLevel | None = None
    name: str = ""
    error: MiniTouchError | None = None

    @property
    def is_valid(self) -> bool:
        """Whether everything was checked and is as it should be."""
        return not self.problems and self.error is None


def validate_submission(
    directory: Path, proving: Callable[[Verdict], tuple[Problem, ...]] | None = None
) -> Validation:
    """Check a submission without trusting it; ``proving`` plays its episodes if the rest passes.

    An older proof is withdrawn if anything fails. A check that could not be made leaves it.

    Raises:
        InfrastructureError: an episode could not be run.
        IncompleteCheckError: the checkpoint is not in it, or the time is up; what was replayed is
            proved.
    """
    verdict = validate(directory)
    if problems := verdict.problems or (proving(verdict) if proving else ()):
        return _failed(verdict, problems)
    return Validation((), level_of(verdict.runs, find_proof(verdict.directory, verdict.files)))


def _failed(verdict: Verdict, problems: tuple[Problem, ...]) -> Validation:
    """Withdraw the proof of a submission in which something differs, if it has one."""
    proof = find_proof(verdict.directory, verdict.files)
    if proof is None or all(one.is_unchecked or one.is_other_protocol for one in problems):
        return Validation(problems)
    found = Problems()
    with found.caught(PROOFS, "remove the proof yourself"):
        withdraw_proof(proof_path(verdict.directory.resolve()))
    return Validation((*problems, *found), withdrawn=None if found else proof.level)


def prove(
    verdict: Verdict,
    *,
    rerun: int = 0,
    fresh_episodes: int = 0,
    draw: str = "",
    engine: EngineOptions = LOCAL,
    time_limit_s: float = TIME_LIMIT_S,
    callbacks: Callbacks = SILENT,
) -> tuple[Problem, ...]:
    """Replay a submission, run some of it again, and write the proof if nothing differs.

    A stronger proof of the same bytes stays. ``rerun``: so many sampled episodes of each policy of
    each run, with its checkpoint. ``fresh_episodes``: so many new ones per task of each run, whose
    seeds follow from ``draw``, by default random bits: nobody may know it before the checkpoint is
    fixed. Fewer than MIN_FRESH_EPISODES give no level. After ``time_limit_s`` no more episodes are
    played.
    """
    known = find_proof(verdict.directory, verdict.files)

    def keep(level: ProofLevel, rerun: int = 0, fresh: FreshProof | None = None) -> None:
        if known is None or PROVED_LEVELS.index(known.level) <= PROVED_LEVELS.index(level):
            proof = make_proof(verdict.files, level, rerun, fresh)
            write_proof(proof, proof_path(verdict.directory.resolve()))

    again = rerun or (RERUN_BEFORE_FRESH if fresh_episodes else 0)
    fresh: FreshProof | None = None
    callbacks.phase("proof", _episode_count(verdict, again, fresh_episodes))
    with open_engine(engine, callbacks.note) as running:
        on_record = within(time_limit_s, callbacks.episode)
        prover = Prover(verdict, running, on_record=on_record)
        is_replayed = False
        try:
            prover.replay()
            is_replayed = True
            if not prover.problems and again:
                prover.run_again(again)
            if not prover.problems and fresh_episodes:
                fresh = prover.run_fresh(fresh_episodes, draw or new_draw())
        except IncompleteCheckError:  # what differs counts all the same, and so does the replay
            if not prover.problems:
                if is_replayed:
                    keep(ProofLevel.REPLAYED)
                raise
    if not prover.problems:
        if fresh and fresh_episodes >= MIN_FRESH_EPISODES:
            keep(ProofLevel.FRESH, again, fresh)
        else:
            keep(ProofLevel.RERUN if again else ProofLevel.REPLAYED, again)
    return tuple(prover.problems)


def within(
    limit_s: float, on_record: Callable[[EpisodeRecord], None]
) -> Callable[[EpisodeRecord], None]:
    """Return a function that takes episodes as ``on_record`` does, until the time is up.

    It raises ``IncompleteCheckError`` after the first episode that ends too late.
    """
    end = time.monotonic() + limit_s

    def take(record: EpisodeRecord) -> None:
        on_record(record)
        if time.monotonic() > end:
            raise IncompleteCheckError(
                f"the check was not finished within {limit_s:g} s; --time-limit gives it longer"
            )

    return take


def _episode_count(verdict: Verdict, again: int, fresh: int) -> int:
    """Return how many episodes a proof plays."""
    count = 0
    for run in verdict.runs.values():
        count += again * len(run.header.policies())
        count += len(run.header.specs())
        count += len(_fresh_specs(run, fresh, 0)) if fresh else 0
    return count


def _fresh_specs(run: Run, count: int, seed: int) -> tuple[EpisodeSpec, ...]:
    """Return ``count`` episodes of each task of a run, with another seed."""
    plan = replace(run.plan, episodes=count, seed=seed, chosen=())
    return plan.specs(exploration=run.header.exploration is not None)


def _drop_problem(drop: FreshResult) -> Problem:
    what = (
        f"{drop.metric} {drop.official:.3f} officially, {drop.fresh:.3f} in "
        f"{drop.episodes} fresh episodes (p = {drop.p:.2g})"
    )
    return Problem(f"{drop.role} {drop.task}", what, FITS_OFFICIAL)


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
            IncompleteCheckError: the policy fails here, as on a slower machine, and did not there.
        """
        failed = []
        for seed in self.verdict.submission.seeds:
            for place in seed.runs.values():
                with self.problems.caught(place):
                    run = self.verdict.runs[place]
                    specs = draw_episodes(run, count, self.rng)
                    setup = self._setup(seed, run)
                    for record, differing in rerun(run, setup, specs, self.engine):
                        self.on_record(record)
                        if differing and record.fault:
                            failed.append(f"{place}, {record.spec.key}: {record.fault}")
                            continue
                        for problem in differing:
                            self.problems.add_below(place, replace(problem, remedy=NOT_REPEATED))
        if failed:
            raise IncompleteCheckError(
                f"{len(failed)} episodes end by a policy fault only when run again; "
                f"the first: {failed[0]}"
            )

    def run_fresh(self, count: int, draw: str) -> FreshProof:
        """Run ``count`` new episodes of each task of each run, and compare with the official ones.

        A significant drop is a problem. On novel shapes they are the first ``count`` of the suite:
        its shapes in its order, in new scenes.
        """
        seeds: dict[str, int] = {}
        played: dict[str, dict[tuple[Role, str], Values]] = {}
        try:
            for seed in self.verdict.submission.seeds:
                for place in seed.runs.values():
                    with self.problems.caught(place):
                        run = self.verdict.runs[place]
                        seeds[place] = fresh_seed(run.header.policy.digest, draw)
                        specs = _fresh_specs(run, count, seeds[place])
                        played[place] = self._play_fresh(run, self._setup(seed, run), specs)
        finally:  # also where the time is up before the last run
            results = {
                place: tuple(compare_fresh(one, *key) for key, one in values.items())
                for place, values in played.items()
            }
            self._judge_drops(results, played)
        return FreshProof(draw, count, seeds, results)

    def _judge_drops(
        self,
        results: Mapping[str, Sequence[FreshResult]],
        played: Mapping[str, Mapping[tuple[Role, str], Values]],
    ) -> None:
        """Add the drops that an honest submission would hardly have."""
        policies = {
            (place, spec.role, spec.task)
            for place, run in self.verdict.runs.items()
            for spec in run.header.specs()
        }
        for place, compared in results.items():
            for drop in significant_drops(compared, planned=len(policies)):
                self.problems.add_below(place, _drop_problem(drop))
        ranked: dict[str, list[Values]] = {}
        for seed in self.verdict.submission.seeds:
            for (role, task), values in played.get(seed.runs.get(MAIN_SUITE, ""), {}).items():
                if role is Role.FINAL:
                    ranked.setdefault(task, []).append(values)
        if ranked and not self.problems and (p := drop_together(ranked.values())) is not None:
            what = f"fresh episodes are worse over the tasks and training seeds (p = {p:.2g})"
            self.problems.add("", what, FITS_OFFICIAL)

    def _play_fresh(
        self, run: Run, setup: PolicySetup, specs: Sequence[EpisodeSpec]
    ) -> dict[tuple[Role, str], Values]:
        """Play fresh episodes; return by role and task what the policy is ranked by.

        Raises:
            IncompleteCheckError: policy faults end many more of them than of the official ones.
        """
        fresh: dict[tuple[Role, str], list[EpisodeMetrics]] = {}
        faults = []
        for record in self.engine.run(setup, specs):
            self.on_record(record)
            fresh.setdefault((record.spec.role, record.spec.task), []).append(measure(record))
            if record.fault:
                faults.append(f"{record.spec.key}: {record.fault}")
        usual = np.mean([row.outcome is Outcome.POLICY_FAULT for _, row in run.rows()])
        if len(faults) / len(specs) > usual + MORE_FAULTS:
            raise IncompleteCheckError(
                f"{len(faults)} of {len(specs)} fresh episodes end by a policy fault, "
                f"{100 * usual:.0f} % of the official ones; the first: {faults[0]}"
            )
        official = dict(run.by_role())
        return {
            (role, task): Values.of(task, [row for row in official[role] if row.task == task], rows)
            for (role, task), rows in fresh.items()
        }

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
