"""How a policy is isolated: the level, what its own code may do, and its limits."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from msgspec import UNSET

from minitouch_bench.records import RunHeader

MAX_ACTS = 256
"""More than the 200 of an episode, for the limit of processor time."""


@dataclass(frozen=True)
class PolicyLimits:
    """How long a policy may take, in s: to load and reset, for one action, for a whole episode.

    The time of an episode is all that is spent on waiting for the policy, and not the world's.
    In the sandbox its memory is limited too, in MiB beyond what the format's packages take.
    """

    load_timeout_s: float = 60.0
    act_timeout_s: float = 5.0
    episode_timeout_s: float = 300.0
    memory_mb: int = 8192

    @property
    def cpu_s(self) -> int:
        """Return the processor time that one thread could use within the timeouts."""
        return math.ceil(self.load_timeout_s + MAX_ACTS * self.act_timeout_s)


def limits_of(header: RunHeader) -> PolicyLimits:
    """Return the limits of time that a run had."""
    limits = PolicyLimits(act_timeout_s=header.act_timeout_s)
    if header.episode_timeout_s is UNSET:
        return limits
    return replace(limits, episode_timeout_s=header.episode_timeout_s)


USUAL_LIMITS = PolicyLimits()
"""The default."""


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
