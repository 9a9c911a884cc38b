"""The command ``record``: a policy's episodes as a dataset, in Minari's format or LeRobot's."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from minitouch_bench.commands import options
from minitouch_bench.commands.options import option
from minitouch_bench.console import episode_progress, note
from minitouch_bench.errors import PolicyFaultError, UsageError
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.policies.policy import Isolation, isolation_options
from minitouch_bench.protocol.minitouch import PROTOCOL, PUBLIC_SEED_BITS

RECORDING_SUITE = "recording"
"""Seeds recorded episodes; no suite has this name."""


def record(
    policy: options.PolicyArgument,
    task: options.TaskArgument,
    *,
    output: Annotated[Path, option("DIR", "Directory of the dataset; it must not exist.")],
    episodes: Annotated[
        int, option("N", "Number of episodes to record.", min=1, max=MAX_EPISODES)
    ] = 100,
    seed: Annotated[int, option("N", "Seed of the episodes.", min=0)] = 0,
    dataset_format: Annotated[
        Literal["minari", "lerobot"], option("minari|lerobot", "Whose format it has.", "--format")
    ] = "minari",
    isolation: options.IsolationLevel = Isolation.SANDBOX.value,
    trust: options.Trust = False,
) -> None:
    """Record a policy's episodes in Minari's format, for train --from-log and other libraries.

    LeRobot's format lacks the last observation of an episode, the rewarded one: --from-log does
    not read it. An episode with a fault ends as truncated. The directory appears when the dataset
    is complete.
    """
    from minitouch_bench.evaluation.policy_setup import prepare_policies
    from minitouch_bench.evaluation.recording import DATASET_WRITERS, record_episodes
    from minitouch_bench.runs.plan import Plan

    if seed.bit_length() > PUBLIC_SEED_BITS:  # the episodes' seeds then have 128
        raise UsageError(f"--seed is below 2^{PUBLIC_SEED_BITS} in a dataset, not {seed}")
    isolated = isolation_options(isolation, trust)
    tasks = (PROTOCOL.task(task).name,)
    plan = Plan(RECORDING_SUITE, tasks, episodes, seed, limits=isolated.limits)
    writer = DATASET_WRITERS[dataset_format]
    writer.library()  # before the policy is loaded
    setup = prepare_policies(policy, plan, isolated, note)
    with episode_progress() as callbacks:
        faults = record_episodes(setup, [*plan.specs()], output, callbacks, writer)
    print(output)
    if faults:
        note(f"{faults} of {episodes} episodes end with a fault of the policy")
        raise typer.Exit(PolicyFaultError.exit_code)
