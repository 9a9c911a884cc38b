"""Check one submission as a maintainer does, and write the proof of what was checked.

Its actions are replayed, and sampled and fresh episodes are run with its checkpoint.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.errors import (
    IncompleteCheckError,
    InfrastructureError,
    IsolationError,
    MiniTouchError,
    MissingExtraError,
)
from minitouch_bench.evaluation.engine import EngineOptions, open_engine
from minitouch_bench.leaderboard.proof import (
    MIN_FRESH_EPISODES,
    PROOFS,
    FreshProof,
    ProofLevel,
    find_proof,
    level_of,
    make_proof,
    proof_path,
    withdraw_proof,
    write_proof,
)
from minitouch_bench.leaderboard.validation import Verdict, validate
from minitouch_bench.records import EpisodeRecord
from minitouch_bench.verification.fresh import new_draw
from minitouch_bench.verification.problems import Problem, Problems
from minitouch_bench.workflows import SILENT, Callbacks
from minitouch_bench.workflows.prover import Prover, fresh_specs

RERUN_BEFORE_FRESH = 50
"""Drawn episodes of each policy of a run that are run before fresh ones, unless N is asked."""

UNCHECKED = (IncompleteCheckError, MissingExtraError, IsolationError, InfrastructureError)
"""What ends a check without a verdict on the submission."""

TIME_LIMIT_S = 6 * 3600.0
"""How long the check of one submission may take: a policy may use minutes in each episode."""


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

    An older proof is withdrawn if an episode differs. Problems of the files leave it, and the
    leaderboard refuses the row because of them; so does a check that could not be made.

    Raises:
        IncompleteCheckError: see ``prove``.
    """
    verdict = validate(directory)
    if verdict.problems:
        return Validation(verdict.problems)
    if problems := proving(verdict) if proving else ():
        return _failed(verdict, problems)
    return Validation((), level_of(verdict.runs, find_proof(verdict.directory, verdict.files)))


def _failed(verdict: Verdict, problems: tuple[Problem, ...]) -> Validation:
    """Withdraw the proof of a submission in which something differs, if it has one."""
    proof = find_proof(verdict.directory, verdict.files)
    if proof is None or all(one.is_unchecked for one in problems):
        return Validation(problems)
    found = Problems()
    with found.caught(PROOFS, "remove the proof yourself"):
        withdraw_proof(proof_path(verdict.directory))
    return Validation((*problems, *found), withdrawn=None if found else proof.level)


def prove(
    verdict: Verdict,
    *,
    engine: EngineOptions,
    rerun: int = 0,
    fresh_episodes: int = 0,
    draw: str = "",
    time_limit_s: float = TIME_LIMIT_S,
    callbacks: Callbacks = SILENT,
) -> tuple[Problem, ...]:
    """Replay a submission, run some of it again, and write the proof if nothing differs.

    A stronger proof of the same bytes stays. ``rerun``: so many sampled episodes of each policy of
    each run, with its checkpoint. ``fresh_episodes``: so many new ones per task of each run, whose
    seeds follow from ``draw``, by default random bits: nobody may know it before the checkpoint is
    fixed. Fewer than MIN_FRESH_EPISODES give no level. After ``time_limit_s`` no more episodes are
    played.

    Raises:
        IncompleteCheckError: the checkpoint is not in the submission, the time is up, or this
            machine cannot play its episodes; what was replayed is proved.
    """
    known = find_proof(verdict.directory, verdict.files)

    def keep(level: ProofLevel, rerun: int = 0, fresh: FreshProof | None = None) -> None:
        proof = make_proof(verdict.files, level, rerun, fresh)
        if known is None or known.strength <= proof.strength:
            write_proof(proof, proof_path(verdict.directory))

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
        except UNCHECKED as error:  # what differs counts all the same, and so does the replay
            if not prover.problems:
                if is_replayed:
                    keep(ProofLevel.REPLAYED)
                raise IncompleteCheckError(str(error)) from error
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
        count += len(fresh_specs(run, fresh, 0)) if fresh else 0
    return count
