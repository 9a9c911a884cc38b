"""How a policy is isolated: the level, what its own code may do, and its limits."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import (
    ACT_TIMEOUT_S,
    EPISODE_TIMEOUT_S,
    LOAD_TIMEOUT_S,
    PROTOCOL,
)

MAX_TIMEOUT_S = 86400.0
MAX_MEMORY_MB = 2**24

Seconds = Annotated[float, Meta(gt=0)]

MAX_ACTS = max(task.max_steps for task in PROTOCOL.tasks)
"""Acts in the longest episode, for the limit of processor time."""


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
class PolicyLimits:
    """How long a policy may take, in s: to load and reset, for one action, for a whole episode.

    The time of an episode is all that is spent on waiting for the policy, and not the world's.
    In the sandbox its memory is limited too, in MiB beyond what the format's packages take.

    Raises:
        UsageError: a time that cannot be waited for.
    """

    load_timeout_s: Seconds = LOAD_TIMEOUT_S
    act_timeout_s: Seconds = ACT_TIMEOUT_S
    episode_timeout_s: Seconds = EPISODE_TIMEOUT_S
    memory_mb: Annotated[int, Meta(gt=0)] = 8192

    def __post_init__(self) -> None:
        for limit in (self.load_timeout_s, self.act_timeout_s, self.episode_timeout_s):
            if not 0 < limit <= MAX_TIMEOUT_S:
                raise UsageError(
                    f"a time limit is above 0 and at most {MAX_TIMEOUT_S:g} s, not {limit}"
                )
        if not 0 < self.memory_mb <= MAX_MEMORY_MB:
            raise UsageError(f"a memory limit is 1 to {MAX_MEMORY_MB} MiB, not {self.memory_mb}")

    def as_options(self) -> tuple[str, ...]:
        """Return the command line's options for the times that are not the protocol's."""
        words: list[str] = []
        if self.act_timeout_s != ACT_TIMEOUT_S:
            words += ["--act-timeout", f"{self.act_timeout_s:.15g}"]
        if self.episode_timeout_s != EPISODE_TIMEOUT_S:
            words += ["--episode-timeout", f"{self.episode_timeout_s:.15g}"]
        return tuple(words)

    def within(self, most: "PolicyLimits") -> "PolicyLimits":
        """Return these limits, each of them at most that of ``most``."""
        return PolicyLimits(
            *(min(getattr(self, one.name), getattr(most, one.name)) for one in fields(self))
        )

    @property
    def cpu_s(self) -> int:
        """Return the processor time that one thread could use within the timeouts."""
        return math.ceil(self.load_timeout_s + MAX_ACTS * self.act_timeout_s)


USUAL_LIMITS = PolicyLimits()
"""The default."""


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
