"""The two kinds of actor, and which one serves a policy."""

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.evaluation.rollout import Actor
from minitouch_bench.policies.holding import hold
from minitouch_bench.policies.in_process import InProcessPolicy
from minitouch_bench.policies.isolation.levels import Isolation
from minitouch_bench.policies.policy import Observation
from minitouch_bench.policies.process import PolicyLimits, PolicyProcess
from minitouch_bench.policies.scripted import Controller, make_controller
from minitouch_bench.policies.sources import PolicySource
from minitouch_bench.protocol.seeds import policy_seed
from minitouch_bench.records import EpisodeSpec, Role
from minitouch_bench.tasks.environment import MiniTouchEnv


class ProcessActor:
    """A policy that is held away from the simulator, or loaded beside it for debugging."""

    def __init__(self, process: PolicyProcess | InProcessPolicy) -> None:
        self._process = process

    def begin(self, environment: MiniTouchEnv, spec: EpisodeSpec) -> None:
        """Fork and load afresh."""
        self._process.reset(policy_seed(spec.seed), spec.task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Ask the process."""
        return self._process.act(observation)

    def close(self) -> None:
        """End the process."""
        self._process.close()


class ScriptedActor:
    """The scripted policy, which sits beside the simulator because it reads it."""

    _controller: Controller

    def begin(self, environment: MiniTouchEnv, spec: EpisodeSpec) -> None:
        """Make a new controller."""
        self._controller = make_controller(environment)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Ask the controller, which looks past the observation."""
        return self._controller.act()

    def close(self) -> None:
        """Do nothing: there is no process."""


def make_actor(
    source: PolicySource,
    role: Role,
    limits: PolicyLimits,
    isolation: Isolation = Isolation.SANDBOX,
    *,
    trust: bool,
) -> ProcessActor | ScriptedActor:
    """Return the actor of a policy; exploration policies act stochastically."""
    if source.kind == "scripted":
        return ScriptedActor()
    deterministic = role is Role.FINAL
    return ProcessActor(hold(source, limits, isolation, deterministic=deterministic, trust=trust))


__all__ = ["Actor", "ProcessActor", "ScriptedActor", "make_actor"]
