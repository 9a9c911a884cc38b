"""Check a submission as a maintainer does, and write the proof of what was checked."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from minitouch_bench.evaluation.engine import LOCAL, EngineOptions, open_engine
from minitouch_bench.evaluation.suites import find_suite
from minitouch_bench.leaderboard import proving
from minitouch_bench.leaderboard.proof import (
    FreshProof,
    ProofLevel,
    find_proof,
    level_of,
    make_proof,
    proof_path,
    write_proof,
)
from minitouch_bench.leaderboard.submission import MAIN_SUITE
from minitouch_bench.leaderboard.validation import Verdict, validate
from minitouch_bench.verification.fresh import new_draw
from minitouch_bench.verification.problems import Problem
from minitouch_bench.workflows import SILENT, Callbacks

RERUN_BEFORE_FRESH = 5
"""Drawn episodes of each run that are run before fresh ones, where no other number is asked."""


@dataclass(frozen=True)
class ValidateOptions:
    """How far to check.

    ``replay``: the recorded actions. ``rerun``: so many drawn episodes of each run with the
    checkpoint. ``fresh_episodes``: so many new ones per task, whose seeds follow from ``draw``,
    by default random bits. Each of them includes those before it.
    """

    replay: bool = False
    rerun: int = 0
    fresh_episodes: int = 0
    draw: str = field(default_factory=new_draw)
    engine: EngineOptions = LOCAL


@dataclass(frozen=True)
class Validation:
    """What came of it: the problems, or where there are none the level of proof."""

    problems: tuple[Problem, ...]
    level: ProofLevel | None = None


def validate_submission(
    directory: Path, options: ValidateOptions, callbacks: Callbacks = SILENT
) -> Validation:
    """Check a submission without trusting it; a proof is written beside it if all holds.

    Raises:
        InfrastructureError: an episode could not be run.
    """
    verdict = validate(directory)
    if not verdict.passed:
        return Validation(verdict.problems)
    if options.replay or options.rerun or options.fresh_episodes:
        problems = _prove(verdict, options, callbacks)
        if problems:
            return Validation(problems)
    return Validation((), level_of(verdict, find_proof(verdict)))


def _prove(verdict: Verdict, options: ValidateOptions, callbacks: Callbacks) -> tuple[Problem, ...]:
    """Replay a submission, run some of it again, and write the proof if all holds."""
    rerun = options.rerun or (RERUN_BEFORE_FRESH if options.fresh_episodes else 0)
    fresh: FreshProof | None = None
    callbacks.phase("proof", _episode_count(verdict, rerun, options.fresh_episodes))
    with open_engine(options.engine, callbacks.note) as engine:
        how = proving.Proving(engine, on_record=callbacks.episode)
        problems = [*proving.replay(verdict, how)]
        if not problems and rerun:
            problems += proving.run_again(verdict, rerun, how)
        if not problems and options.fresh_episodes:
            fresh, found = proving.run_fresh(verdict, options.fresh_episodes, options.draw, how)
            problems += found
    if not problems:
        level = ProofLevel.RERUN if rerun else ProofLevel.REPLAYED
        sketches = proving.sketch_runs(verdict)
        proof = make_proof(verdict, ProofLevel.FRESH if fresh else level, rerun, fresh, sketches)
        write_proof(proof, proof_path(verdict.directory.resolve()))
    return tuple(problems)


def _episode_count(verdict: Verdict, rerun: int, fresh: int) -> int:
    """Return how many episodes a proof plays."""
    assert verdict.submission is not None
    count = rerun * len(verdict.runs)
    for run in verdict.runs.values():
        count += len(run.episodes) + len(run.exploration_episodes)
    for seed in verdict.submission.seeds:
        has_exploration = verdict.runs[seed.runs[MAIN_SUITE]].header.exploration is not None
        suite = replace(find_suite(MAIN_SUITE), episodes_per_task=fresh)
        count += len(suite.episodes(exploration=has_exploration))
    return count
