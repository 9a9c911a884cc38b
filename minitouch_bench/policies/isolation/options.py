"""How a policy is isolated: the level, what its own code may do, and its limits."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from minitouch_bench.policies.limits import USUAL_LIMITS, PolicyLimits


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
