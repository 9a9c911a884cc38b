"""How long a policy may take, and how much memory."""

import math
from dataclasses import dataclass, replace

from msgspec import UNSET

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import ACT_TIMEOUT_S, EPISODE_TIMEOUT_S, LOAD_TIMEOUT_S
from minitouch_bench.records import RunHeader

MAX_ACTS = 256
"""More than the 200 of an episode, for the limit of processor time."""


@dataclass(frozen=True)
class PolicyLimits:
    """How long a policy may take, in s: to load and reset, for one action, for a whole episode.

    The time of an episode is all that is spent on waiting for the policy, and not the world's.
    In the sandbox its memory is limited too, in MiB beyond what the format's packages take.

    Raises:
        UsageError: a time that cannot be waited for.
    """

    load_timeout_s: float = LOAD_TIMEOUT_S
    act_timeout_s: float = ACT_TIMEOUT_S
    episode_timeout_s: float = EPISODE_TIMEOUT_S
    memory_mb: int = 8192

    def __post_init__(self) -> None:
        for limit in (self.load_timeout_s, self.act_timeout_s, self.episode_timeout_s):
            if not 0 < limit < math.inf:
                raise UsageError(f"a time limit is a number of seconds above 0, not {limit}")

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
