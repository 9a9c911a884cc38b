"""Which way a policy is held, and a first look at whether it can be."""

import contextlib
from collections.abc import Sequence

from minitouch_bench.errors import InfrastructureError, PolicyFaultError, PolicyLoadError
from minitouch_bench.policies.in_process import InProcessPolicy
from minitouch_bench.policies.isolation.levels import Isolation
from minitouch_bench.policies.policy import zero_observation
from minitouch_bench.policies.process import PolicyLimits, PolicyProcess
from minitouch_bench.policies.sources import PolicySource

PROBES = 3
"""How often a first look is taken where something other than the policy fails."""


def held_level(source: PolicySource, asked: Isolation) -> Isolation:
    """Return the level at which a policy is held where one was asked for.

    The scripted policy sits beside the simulator, because it reads it. A remote one needs the
    network, and its process runs nothing but our own client.
    """
    if source.kind == "scripted":
        return Isolation.NONE
    if source.kind == "remote" and asked is Isolation.SANDBOX:
        return Isolation.PROCESS
    return asked


def hold(
    source: PolicySource,
    limits: PolicyLimits | None = None,
    isolation: Isolation = Isolation.SANDBOX,
    *,
    deterministic: bool = True,
    trust: bool = False,
) -> PolicyProcess | InProcessPolicy:
    """Return a policy, held as asked."""
    level = held_level(source, isolation)
    if level is Isolation.NONE:
        return InProcessPolicy(source, deterministic=deterministic, trust=trust)
    return PolicyProcess(source, limits, level, deterministic=deterministic, trust=trust)


def probe(
    source: PolicySource,
    tasks: Sequence[str],
    limits: PolicyLimits | None = None,
    isolation: Isolation = Isolation.SANDBOX,
    *,
    deterministic: bool = True,
    trust: bool = False,
) -> None:
    """Load every checkpoint of a source once, so that a bad one is refused before any episode.

    One action is asked for as well, but a fault in it is left to the episodes.

    Raises:
        PolicyLoadError: it cannot be loaded or reset.
        IsolationError: this machine cannot hold it as asked.
        MissingExtraError: an optional package is not installed.
        InfrastructureError: its host process ended again and again.

    """
    if source.kind == "scripted":
        return
    for attempt in range(PROBES):
        try:
            _probe(source, tasks, limits, isolation, deterministic=deterministic, trust=trust)
        except InfrastructureError:  # its host was killed, say
            if attempt == PROBES - 1:
                raise
        else:
            return


def _probe(
    source: PolicySource,
    tasks: Sequence[str],
    limits: PolicyLimits | None,
    isolation: Isolation,
    *,
    deterministic: bool,
    trust: bool,
) -> None:
    first_task = {source.for_task(task): task for task in reversed(tasks)}
    with contextlib.closing(
        hold(source, limits, isolation, deterministic=deterministic, trust=trust)
    ) as policy:
        for part, task in first_task.items():
            try:
                policy.reset(0, task)
            except PolicyFaultError as fault:
                raise PolicyLoadError(f"{part.target} cannot be reset: {fault}") from fault
            with contextlib.suppress(PolicyFaultError):
                policy.act(zero_observation())
