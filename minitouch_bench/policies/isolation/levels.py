"""How a policy is isolated: the level, and what its own code may do."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from minitouch_bench.errors import UsageError
from minitouch_bench.perturbation import USUAL_LIMITS, PolicyLimits
from minitouch_bench.protocol.minitouch import (
    ACT_TIMEOUT_S,
    EPISODE_TIMEOUT_S,
)


class Isolation(StrEnum):
    """The levels of isolation, strictest first."""

    SANDBOX = "sandbox"
    """A process of its own that can reach neither files, network nor other processes."""

    PROCESS = "process"
    """A process of its own, with all the rights of the user who runs the evaluation."""

    NONE = "none"
    """The process of the simulator, for debugging."""


def weakest(levels: Iterable[Isolation]) -> Isolation:
    """Return the weakest of some levels."""
    return max(levels, key=list(Isolation).index)


@dataclass(frozen=True)
class IsolationOptions:
    """How to isolate a policy. ``trust`` permits Python code that comes with it.

    ``private`` is the run's directory, which a policy must not read: "" where there is none.
    """

    level: Isolation = Isolation.SANDBOX
    trust: bool = False
    limits: PolicyLimits = USUAL_LIMITS
    private: str = ""


SANDBOXED = IsolationOptions()
"""The default."""


def isolation_options(
    isolation: str,
    trust: bool,
    act_timeout: float = ACT_TIMEOUT_S,
    episode_timeout: float = EPISODE_TIMEOUT_S,
) -> IsolationOptions:
    """Return how to isolate a policy.

    Raises:
        UsageError: there is no such level, or a time cannot be waited for.
    """
    if isolation not in tuple(Isolation):
        raise UsageError(f"no isolation '{isolation}'; it is one of {', '.join(Isolation)}")
    limits = PolicyLimits(act_timeout_s=act_timeout, episode_timeout_s=episode_timeout)
    return IsolationOptions(Isolation(isolation), trust, limits)
