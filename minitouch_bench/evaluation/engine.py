"""What an engine is: something that runs episodes and yields their records."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from minitouch_bench.evaluation.actors import make_actor
from minitouch_bench.evaluation.rollout import Actor, run_episode
from minitouch_bench.policies.holding import held_level
from minitouch_bench.policies.isolation.levels import Isolation, weakest
from minitouch_bench.policies.process import PolicyLimits
from minitouch_bench.policies.sources import PolicySource
from minitouch_bench.records import EpisodeRecord, EpisodeSpec, Role
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.registration import make_environment

DEFAULT_LIMITS = PolicyLimits()


@dataclass(frozen=True)
class Contest:
    """The policies of a run by role, and how they are held."""

    policy: PolicySource
    exploration: PolicySource | None = None
    limits: PolicyLimits = DEFAULT_LIMITS
    trust: bool = False
    isolation: Isolation = Isolation.SANDBOX

    def source(self, role: Role) -> PolicySource:
        """Return the policy of a role."""
        if role is Role.FINAL:
            return self.policy
        assert self.exploration is not None
        return self.exploration

    def held_level(self) -> Isolation:
        """Return the level that every policy of the run was held at, or a stricter one."""
        sources = [self.policy, *([self.exploration] if self.exploration else [])]
        return weakest([held_level(source, self.isolation) for source in sources])

    def make_actor(self, role: Role) -> Actor:
        """Return a new actor, which holds the policy of a role as the contest says."""
        return make_actor(self.source(role), role, self.limits, self.isolation, trust=self.trust)


class ActorSource(Protocol):
    """Where a worker gets its actors from: a contest's policies, or a run's recorded actions."""

    def make_actor(self, role: Role) -> Actor:
        """Return a new actor for the episodes of a role."""


class Engine(Protocol):
    """Runs episodes somewhere; their results depend on nothing but the episodes."""

    def run(self, source: ActorSource, specs: Sequence[EpisodeSpec]) -> Iterator[EpisodeRecord]:
        """Yield one record an episode, in whatever order they end.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy.
        """


class EpisodeRunner:
    """Runs episodes one after the other in this process, keeping environments and policies."""

    def __init__(self, source: ActorSource) -> None:
        self._source = source
        self._environments: dict[str, MiniTouchEnv] = {}
        self._actors: dict[Role, Actor] = {}

    def run(self, spec: EpisodeSpec) -> EpisodeRecord:
        """Run one episode."""
        if spec.task not in self._environments:
            self._environments[spec.task] = make_environment(spec.task)
        if spec.role not in self._actors:
            self._actors[spec.role] = self._source.make_actor(spec.role)
        return run_episode(self._environments[spec.task], self._actors[spec.role], spec)

    def close(self) -> None:
        """End the policies and the worlds."""
        for actor in self._actors.values():
            actor.close()
        for environment in self._environments.values():
            environment.close()
