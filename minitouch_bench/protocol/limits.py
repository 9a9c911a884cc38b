"""What a policy may take: time, and in the sandbox memory."""

import math
from dataclasses import dataclass, fields
from typing import Annotated

from msgspec import Meta

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.text import exact

LOAD_TIMEOUT_S, ACT_TIMEOUT_S, EPISODE_TIMEOUT_S = 60.0, 5.0, 300.0
"""How long a policy may take, in s: to load and reset, for one action, for a whole episode."""

MEMORY_LIMIT_MB = 8192
"""Memory of a policy in the sandbox, in MiB beyond what the format's packages take."""

MAX_TIMEOUT_S = 86400.0
MAX_MEMORY_MB = 2**24

Seconds = Annotated[float, Meta(gt=0)]


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
    memory_mb: Annotated[int, Meta(gt=0)] = MEMORY_LIMIT_MB

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
        act, episode = self.act_timeout_s, self.episode_timeout_s
        words = ("--act-timeout", exact(act)) if act != ACT_TIMEOUT_S else ()
        if episode == EPISODE_TIMEOUT_S:
            return words
        return (*words, "--episode-timeout", exact(episode))

    def within(self, most: "PolicyLimits") -> "PolicyLimits":
        """Return these limits, each of them at most that of ``most``."""
        return PolicyLimits(
            *(min(getattr(self, one.name), getattr(most, one.name)) for one in fields(self))
        )

    @property
    def cpu_s(self) -> int:
        """Return the processor time that one thread could use within the timeouts."""
        acts = max(task.max_steps for task in PROTOCOL.tasks)
        return math.ceil(self.load_timeout_s + acts * self.act_timeout_s)


USUAL_LIMITS = PolicyLimits()
"""The default."""
