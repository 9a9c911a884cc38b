"""``minitouch-bench verify``: the recorded actions of a run are played again and compared."""

import json
import os
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench import errors
from minitouch_bench.commands import options
from minitouch_bench.console import data_console, episode_progress, note
from minitouch_bench.episode import IN_MEMORY
from minitouch_bench.evaluation.engine import AUTO
from minitouch_bench.files import SUBMISSION_FILE
from minitouch_bench.policies.policy import (
    SANDBOXED,
    Isolation,
    IsolationOptions,
    isolation_options,
)
from minitouch_bench.text import numbered, printable

if TYPE_CHECKING:
    from minitouch_bench.episode import PolicyIdentity
    from minitouch_bench.evaluation.policy_setup import PolicySetup
    from minitouch_bench.runs.run import Run
    from minitouch_bench.verification.replay_check import Findings

SHOWN_PROBLEMS = 10
"""Differences that are listed; the others are counted."""

rerun_option = partial(options.option, rich_help_panel="Running again")


def verify(
    run: options.RunDirectory,
    *,
    rerun: Annotated[
        int,
        rerun_option("N", "Also run N sampled episodes of each policy with its checkpoint.", min=0),
    ] = 0,
    policy: Annotated[
        str | None,
        rerun_option("POLICY", "Where the checkpoint is now; by default the recorded place."),
    ] = None,
    exploration: Annotated[
        str | None, rerun_option("POLICY", "Where the exploration checkpoint is now.")
    ] = None,
    workers: options.Workers = AUTO,
    engine: options.EngineName = "local",
    address: options.Address = None,
    isolation: options.IsolationLevel = Isolation.SANDBOX.value,
    trust: options.Trust = False,
    as_json: options.AsJson = False,
) -> None:
    """Replay a run's recorded actions and recompute every estimate; exit 1 if any differs."""
    import numpy as np

    from minitouch_bench.evaluation.engine import open_engine
    from minitouch_bench.runs.run import read_run
    from minitouch_bench.verification import replay_check
    from minitouch_bench.verification.static_check import check_run

    opening = open_engine(engine, workers, address)
    isolated = isolation_options(isolation, trust)
    if not rerun and (policy, exploration, isolated) != (None, None, SANDBOXED):
        raise errors.UsageError(
            "--policy, --exploration, --isolation and --trust need --rerun N: without it no policy "
            "is run"
        )
    opened = read_run(run)
    found = replay_check.Findings(check_run(opened))
    if found.passed:
        setup = _prepare_rerun(opened, policy, exploration, isolated) if rerun else None
        opened.plan.load_objects()  # or refuse before any progress is shown
        for spec in opened.header.specs():
            opened.actions_of(spec.key)
        with episode_progress() as callbacks, opening as running:
            callbacks.phase("replaying", len(opened.header.specs()))
            found = replay_check.replay_run(opened, running, callbacks.episode)
            if setup is not None and found.passed:
                specs = replay_check.draw_episodes(opened, rerun, np.random.default_rng())
                callbacks.phase("running again", len(specs))
                again = replay_check.run_again(opened, setup, specs, running, callbacks.episode)
                found = replace(again, replayed=found.replayed)
    if as_json:
        print(json.dumps({"passed": found.passed, **asdict(found)}, indent=1))
    else:
        _show(found, run)
    if not found.passed:
        raise typer.Exit(errors.CHECK_FAILED)


def _prepare_rerun(
    run: "Run", policy: str | None, exploration: str | None, isolation: IsolationOptions
) -> "PolicySetup":
    """Load the policies of a run again, from where they are now or were."""
    from minitouch_bench.verification import replay_check

    header = run.header
    if exploration is not None and header.exploration is None:
        raise errors.UsageError(
            f"--exploration: {run.place} has no exploration episodes; leave it out"
        )
    if IN_MEMORY in {one.kind for one in header.policies()}:
        raise errors.IncompleteCheckError(
            "a policy of the run was an object in memory, which cannot be loaded again.\n"
            "Leave out --rerun, or evaluate the policy from a file"
        )
    policy = policy or _source_of(header.policy, "--policy")
    exploration = exploration or _source_of(header.exploration, "--exploration")
    return replay_check.prepare_rerun(run, policy, exploration, isolation, note)


def _source_of(recorded: "PolicyIdentity | None", option: str) -> str | None:
    """Return where a run's checkpoint was.

    The run's maker chooses neither who is contacted nor what code is run.

    Raises:
        IncompleteCheckError: it is not there now, or not on this machine.
    """
    from minitouch_bench.policies.sources import FACTORY_PATTERN, is_remote

    if recorded is None:
        return None
    if is_remote(recorded.source) or FACTORY_PATTERN.fullmatch(recorded.source):
        raise errors.IncompleteCheckError(
            f"the policy is {recorded.source}, which is contacted or run only if you name it.\n"
            f"If you trust it, give it with {option}"
        )
    submission = Path(recorded.source).parent / SUBMISSION_FILE  # its trainings are no directories
    if recorded.digest and not (os.path.exists(recorded.source) or submission.is_file()):
        raise errors.IncompleteCheckError(
            f"the checkpoint {recorded.source} is gone: no episode can be run again.\n"
            f"Say with {option} where it is now"
        )
    return recorded.source


def _show(found: "Findings", run: Path) -> None:
    for problem in found.problems[:SHOWN_PROBLEMS]:
        print(printable(str(problem)))
    if len(found.problems) > SHOWN_PROBLEMS:
        print(f"... and {len(found.problems) - SHOWN_PROBLEMS} more")
    if found.replayed:
        print(f"{numbered(found.replayed, 'episode')} replayed from their recorded actions")
    if found.reran:
        print(f"{numbered(found.reran, 'episode')} run again with the checkpoint")
    answer, style = "is not verified", "bold red"
    if found.passed:
        answer, style = "is verified: every number follows from its episodes", "bold green"
    answer = printable(f"{run} {answer}")
    data_console().print(answer, style=style, markup=False, highlight=False, soft_wrap=True)
