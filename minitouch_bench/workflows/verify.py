"""Check a run: replay its recorded actions, and run drawn episodes with its checkpoint."""

import secrets
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from minitouch_bench.errors import IncompleteCheckError, InterruptedRunError
from minitouch_bench.evaluation.actors import PolicySetup, prepare_policies
from minitouch_bench.evaluation.engine import LOCAL, EngineOptions, open_engine
from minitouch_bench.policies.isolation.options import SANDBOXED, IsolationOptions
from minitouch_bench.policies.limits import limits_of
from minitouch_bench.policies.sources import is_remote
from minitouch_bench.records import PolicyIdentity
from minitouch_bench.reporting.run_directory import read_run
from minitouch_bench.verification.problems import Problem
from minitouch_bench.verification.recorded_run import open_run
from minitouch_bench.verification.verify import (
    Verification,
    check_identity,
    draw_episodes,
    replay_run,
    rerun,
)
from minitouch_bench.workflows import SILENT, Callbacks


def unforeseen_draw() -> int:
    """Return a seed that nobody can foresee."""
    return secrets.randbits(32)


@dataclass(frozen=True)
class VerifyOptions:
    """How to check a run.

    ``rerun``: how many drawn episodes are also run with the checkpoint. ``policy`` and
    ``exploration``: where the checkpoints lie now, by default where they lay on this machine.
    ``draw``: the seed of the draw, by default one that nobody can foresee.
    """

    run: Path
    rerun: int = 0
    policy: str | None = None
    exploration: str | None = None
    draw: int = field(default_factory=unforeseen_draw)
    engine: EngineOptions = LOCAL
    isolation: IsolationOptions = SANDBOXED


def verify(options: VerifyOptions, callbacks: Callbacks = SILENT) -> Verification:
    """Replay a run and recompute every figure; then run drawn episodes with its checkpoint.

    Raises:
        UsageError: a checkpoint is not the run's.
        IncompleteCheckError: a checkpoint is missing, or elsewhere and not named.
        PolicyError, IsolationError, MissingExtraError: a checkpoint cannot be used.
        RunDirectoryError: it is no run, or a file of it is damaged.
        InfrastructureError, InterruptedRunError: the check is incomplete.
    """
    opening = open_engine(options.engine, callbacks.note)
    setup = _find_checkpoints(options, callbacks) if options.rerun else None
    try:
        with opening as engine:
            run, problems = open_run(options.run)
            if run is None:
                return Verification(0, problems)
            callbacks.phase("replaying", len(run.specs))
            replayed = replay_run(run, engine, callbacks.episode)
            if setup is None or not replayed.passed:
                return replayed
            specs = draw_episodes(run, options.rerun, np.random.default_rng(options.draw))
            callbacks.phase("running again", len(specs))
            differing: list[Problem] = []
            for record, found in rerun(run, setup, specs, engine):
                differing += found
                callbacks.episode(record)
            return replace(replayed, problems=tuple(differing), reran=len(specs))
    except KeyboardInterrupt as error:
        raise InterruptedRunError("interrupted; nothing was changed") from error


def _find_checkpoints(options: VerifyOptions, callbacks: Callbacks) -> PolicySetup:
    """Find the run's checkpoints, see that they are the ones evaluated, and load each once."""
    header = read_run(options.run).header
    policy = options.policy or _source_of(header.policy, "--policy")
    exploration = None
    if header.exploration is not None:
        exploration = options.exploration or _source_of(header.exploration, "--exploration")
    isolation = replace(options.isolation, limits=limits_of(header))
    setup = prepare_policies(
        policy,
        header.tasks,
        isolation,
        callbacks.note,
        exploration=exploration,
        conditions=header.played_under,
    )
    check_identity(header.policy, setup.policy)
    if header.exploration is not None and setup.exploration is not None:
        check_identity(header.exploration, setup.exploration)
    return setup


def _source_of(recorded: PolicyIdentity, option: str) -> str:
    """Return where a run's checkpoint was; the run's maker does not choose who is contacted.

    Raises:
        IncompleteCheckError: it is not there now, or not on this machine.
    """
    if is_remote(recorded.source):
        raise IncompleteCheckError(
            f"the policy is at {recorded.source}, which is contacted only if you name it.\n"
            f"If you trust that address, give it with {option}"
        )
    if recorded.digest and not Path(recorded.source).exists():
        raise IncompleteCheckError(
            f"the checkpoint {recorded.source} is gone: no episode can be run again.\n"
            f"Say with {option} where it is now"
        )
    return recorded.source
