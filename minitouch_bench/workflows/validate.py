"""Check a submission as a maintainer does, and write the proof of what was checked."""

from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.evaluation.engine import LOCAL, EngineOptions, open_engine
from minitouch_bench.leaderboard import proving
from minitouch_bench.leaderboard.faults import Fault
from minitouch_bench.leaderboard.proof import (
    ProofLevel,
    level_of,
    make_proof,
    proof_path,
    read_proof,
    write_proof,
)
from minitouch_bench.leaderboard.validation import Verdict, validate
from minitouch_bench.workflows.callbacks import SILENT, Callbacks


@dataclass(frozen=True)
class ValidateOptions:
    """How far to check: replay the recorded actions, run ``rerun`` drawn episodes of each run."""

    replay: bool = False
    rerun: int = 0
    engine: EngineOptions = LOCAL


@dataclass(frozen=True)
class Validation:
    """What came of it: the faults, or where there are none the level of proof."""

    faults: tuple[Fault, ...]
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
        return Validation(verdict.faults)
    if options.replay or options.rerun:
        faults = _prove(verdict, options, callbacks)
        if faults:
            return Validation(faults)
    proof = read_proof(proof_path(directory.resolve()))
    return Validation((), level_of(verdict, proof))


def _prove(verdict: Verdict, options: ValidateOptions, callbacks: Callbacks) -> tuple[Fault, ...]:
    """Replay a submission, run some of it again, and write the proof if all holds."""
    replayed = sum(len(r.episodes) + len(r.exploration_episodes) for r in verdict.runs.values())
    callbacks.phase("replay", replayed + options.rerun * len(verdict.runs))
    with open_engine(options.engine, callbacks.note) as handle:
        how = proving.Proving(handle.engine, on_record=callbacks.episode)
        faults = [*proving.replay(verdict, how)]
        if not faults and options.rerun:
            faults += proving.run_again(verdict, options.rerun, how)
    if not faults:
        level = ProofLevel.RERUN if options.rerun else ProofLevel.REPLAYED
        proof = make_proof(verdict, level, options.rerun)
        write_proof(proof, proof_path(verdict.directory.resolve()))
    return tuple(faults)
