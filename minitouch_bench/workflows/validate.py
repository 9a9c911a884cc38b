"""Check a submission as a maintainer does, and write the proof of what was checked."""

from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.evaluation.engine import LOCAL, EngineOptions, open_engine
from minitouch_bench.leaderboard import proving
from minitouch_bench.leaderboard.proof import (
    ProofLevel,
    level_of,
    make_proof,
    proof_path,
    read_proof,
    write_proof,
)
from minitouch_bench.leaderboard.validation import Verdict, validate
from minitouch_bench.verification.problems import Problem
from minitouch_bench.workflows import SILENT, Callbacks


@dataclass(frozen=True)
class ValidateOptions:
    """How far to check: replay the recorded actions, run ``rerun`` drawn episodes of each run."""

    replay: bool = False
    rerun: int = 0
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
    if options.replay or options.rerun:
        problems = _prove(verdict, options, callbacks)
        if problems:
            return Validation(problems)
    proof = read_proof(proof_path(directory.resolve()))
    return Validation((), level_of(verdict, proof))


def _prove(verdict: Verdict, options: ValidateOptions, callbacks: Callbacks) -> tuple[Problem, ...]:
    """Replay a submission, run some of it again, and write the proof if all holds."""
    replayed = sum(len(r.episodes) + len(r.exploration_episodes) for r in verdict.runs.values())
    callbacks.phase("replay", replayed + options.rerun * len(verdict.runs))
    with open_engine(options.engine, callbacks.note) as handle:
        how = proving.Proving(handle.engine, on_record=callbacks.episode)
        problems = [*proving.replay(verdict, how)]
        if not problems and options.rerun:
            problems += proving.run_again(verdict, options.rerun, how)
    if not problems:
        level = ProofLevel.RERUN if options.rerun else ProofLevel.REPLAYED
        proof = make_proof(verdict, level, options.rerun)
        write_proof(proof, proof_path(verdict.directory.resolve()))
    return tuple(problems)
