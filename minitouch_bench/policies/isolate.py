"""Run a policy isolated as asked, and try it once before a run."""

import contextlib
from collections.abc import Sequence
from dataclasses import replace

from minitouch_bench.errors import InfrastructureError, PolicyFaultError, PolicyLoadError
from minitouch_bench.policies.in_process import InProcessPolicy
from minitouch_bench.policies.isolation.options import SANDBOXED, Isolation, IsolationOptions
from minitouch_bench.policies.policy import zero_observation
from minitouch_bench.policies.process import PolicyProcess
from minitouch_bench.policies.sources import IN_MEMORY, PolicySource

MAX_TRIALS = 3
"""A policy is tried this often where something other than the policy fails."""


def effective_level(source: PolicySource, asked: Isolation) -> Isolation:
    """Return the level at which a policy runs where one was asked for.

    The scripted policy runs beside the simulator, because it reads it, and an object in memory
    because it may need what its process has. A remote policy needs the network, and its process
    runs only our own client.
    """
    if source.kind in ("scripted", IN_MEMORY):
        return Isolation.NONE
    if source.kind == "remote" and asked is Isolation.SANDBOX:
        return Isolation.PROCESS
    return asked


def isolate(
    source: PolicySource, options: IsolationOptions = SANDBOXED, *, deterministic: bool = True
) -> PolicyProcess | InProcessPolicy:
    """Return the policy of a source, isolated as asked; nothing is loaded before its reset."""
    level = effective_level(source, options.level)
    if level is Isolation.NONE:
        return InProcessPolicy(source, deterministic=deterministic, trust=options.trust)
    return PolicyProcess(source, replace(options, level=level), deterministic=deterministic)


def try_policy(
    source: PolicySource,
    tasks: Sequence[str],
    options: IsolationOptions = SANDBOXED,
    *,
    deterministic: bool = True,
) -> None:
    """Load every checkpoint of a source once, so that a bad one is refused before any episode.

    One action is asked for as well, but a fault in it is left to the episodes.

    Raises:
        PolicyLoadError: it cannot be loaded or reset.
        IsolationError: this machine cannot isolate it as asked.
        MissingExtraError: an optional package is not installed.
        InfrastructureError: its host process ended again and again.

    """
    if source.kind == "scripted":
        return
    first_task = {source.for_task(task): task for task in reversed(tasks)}
    for trial in range(1, MAX_TRIALS + 1):
        try:
            with contextlib.closing(
                isolate(source, options, deterministic=deterministic)
            ) as policy:
                for part, task in first_task.items():
                    _try_once(policy, part, task)
        except InfrastructureError:  # its host was killed, say
            if trial == MAX_TRIALS:
                raise
        else:
            return


def _try_once(policy: PolicyProcess | InProcessPolicy, part: PolicySource, task: str) -> None:
    try:
        policy.reset(0, task)
    except PolicyFaultError as fault:
        raise PolicyLoadError(f"{part.target} cannot be reset: {fault}") from fault
    with contextlib.suppress(PolicyFaultError):
        policy.act(zero_observation())
