"""Check a run: replay its recorded actions, and run drawn episodes with its checkpoint."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.errors import IncompleteCheckError, InterruptedRunError
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.workflows import SILENT, Callbacks, options

if TYPE_CHECKING:
    from minitouch_bench.records import PolicyIdentity
    from minitouch_bench.verification.problems import Findings

rerun_option = partial(typer.Option, rich_help_panel="Running again")


def verify(
    run: options.RunDirectory,
    *,
    rerun: Annotated[int, rerun_option(min=0)] = 0,
    policy: Annotated[str | None, rerun_option()] = None,
    exploration: Annotated[str | None, rerun_option()] = None,
    workers: options.Workers = options.AUTO,
    engine: options.EngineName = "local",
    address: options.Address = None,
    isolation: options.IsolationLevel = Isolation.SANDBOX,
    trust: options.Trust = False,
    callbacks: Callbacks = SILENT,
) -> "Findings":
    """Replay a run's recorded actions and recompute every estimate; exit 1 if any differs.

    Args:
        rerun: Also run N sampled episodes of each policy with its checkpoint.
        policy: Where the checkpoint is now; by default where it was.
        exploration: Where the exploration checkpoint is now.

    Raises:
        UsageError: a checkpoint is not the run's.
        IncompleteCheckError: a checkpoint is missing, elsewhere and not named, or too slow here.
        PolicyError, IsolationError, MissingExtraError: a checkpoint cannot be used.
        RunDirectoryError: it is not a run, or a file of it is damaged.
        InfrastructureError, InterruptedRunError: the check is incomplete.
    """
    import numpy as np

    from minitouch_bench.evaluation.engine import open_engine
    from minitouch_bench.runs.run import read_run
    from minitouch_bench.verification import replay_check
    from minitouch_bench.verification.problems import Findings
    from minitouch_bench.verification.static_check import check_run

    opening = open_engine(options.engine_options(engine, workers, address), callbacks.note)
    opened = read_run(Path(run))
    if problems := check_run(opened):
        return Findings(problems)
    isolated = options.isolation_options(isolation, trust)
    setup = None
    if rerun:
        policy = policy or _source_of(opened.header.policy, "--policy")
        exploration = exploration or _source_of(opened.header.exploration, "--exploration")
        setup = replay_check.prepare_rerun(opened, policy, exploration, isolated, callbacks.note)
    try:
        with opening as running:
            callbacks.phase("replaying", len(opened.header.specs()))
            replayed = replay_check.replay_run(opened, running, callbacks.episode)
            if setup is None or not replayed.passed:
                return replayed
            specs = replay_check.draw_episodes(opened, rerun, np.random.default_rng())
            callbacks.phase("running again", len(specs))
            again = replay_check.run_again(opened, setup, specs, running, callbacks.episode)
            return replace(again, replayed=replayed.replayed)
    except KeyboardInterrupt as error:
        raise InterruptedRunError("interrupted; nothing was changed") from error


def _source_of(recorded: "PolicyIdentity | None", option: str) -> str | None:
    """Return where a run's checkpoint was; the run's maker does not choose who is contacted.

    Raises:
        IncompleteCheckError: it is not there now, or not on this machine.
    """
    from minitouch_bench.policies.sources import is_remote

    if recorded is None:
        return None
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
