"""One episode: the only place where a policy and a simulated world meet."""

from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.conditions import Conditions
from minitouch_bench.errors import PolicyFaultError, PolicyKilledError, PolicyLoadError
from minitouch_bench.evaluation.given_actions import GivenActions, given_path
from minitouch_bench.policies.policy import Observation
from minitouch_bench.records import EpisodeRecord, EpisodeSpec, EpisodeTrace, Outcome, Role
from minitouch_bench.tasks.environment import OUTCOMES, MiniTouchEnv

MAX_ATTEMPTS = 3
"""An episode that meets an infrastructure fault is tried again with its seed, twice."""


class Actor(Protocol):
    """What drives an episode: a policy in its own process, or the scripted one."""

    def reset(self, environment: MiniTouchEnv, spec: EpisodeSpec) -> None:
        """Get ready for an episode, with no memory of earlier ones.

        Raises:
            PolicyFaultError: the policy failed.
        """

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the next action.

        Raises:
            PolicyFaultError: the policy failed.
        """

    def close(self) -> None:
        """Free what it holds."""


class ActorSource(Protocol):
    """Where a worker gets its actors from: a run's policies, or its recorded actions."""

    @property
    def conditions(self) -> Conditions:
        """The conditions of the run's episodes."""

    def make_actor(self, role: Role) -> Actor:
        """Return a new actor for the episodes of a role."""


class EpisodeRunner:
    """Runs episodes one after the other in this process, keeping environments and policies.

    ``attempts`` is the folder of the actions that earlier attempts gave, which must be repeated.
    """

    def __init__(self, source: ActorSource, attempts: Path | None = None) -> None:
        self._source = source
        self._attempts = attempts
        self._environments: dict[str, MiniTouchEnv] = {}
        self._actors: dict[Role, Actor] = {}

    def run(self, spec: EpisodeSpec) -> EpisodeRecord:
        """Run one episode."""
        if spec.task not in self._environments:
            self._environments[spec.task] = MiniTouchEnv(
                spec.task, conditions=self._source.conditions
            )
        if spec.role not in self._actors:
            self._actors[spec.role] = self._source.make_actor(spec.role)
        environment, actor = self._environments[spec.task], self._actors[spec.role]
        path = self._attempts and given_path(self._attempts, spec.key)
        with GivenActions(environment.task.spec.action_size, path) as given:
            return run_episode(environment, actor, spec, given)

    def close(self) -> None:
        """End the policies and the worlds."""
        for actor in self._actors.values():
            actor.close()
        for environment in self._environments.values():
            environment.close()


def run_episode(
    environment: MiniTouchEnv, actor: Actor, spec: EpisodeSpec, given: GivenActions | None = None
) -> EpisodeRecord:
    """Run one episode from its seed to its end.

    A fault of the policy ends the episode, as a failed one. Any other exception is an
    infrastructure fault and passes through.

    Where the policy's process was killed from outside, perhaps by a machine out of memory,
    the episode is tried again, ``MAX_ATTEMPTS`` times in all. A policy could have itself
    killed to get another chance: it must repeat the actions ``given`` in any earlier attempt.
    """
    given = given or GivenActions(environment.task.spec.action_size)
    attempt = _attempt(environment, actor, spec, given)
    for _ in range(MAX_ATTEMPTS - 1):
        if not attempt.killed:
            break
        attempt = _attempt(environment, actor, spec, given)
    return attempt.record


class _Attempt(NamedTuple):
    record: EpisodeRecord
    killed: bool


def _attempt(
    environment: MiniTouchEnv, actor: Actor, spec: EpisodeSpec, given: GivenActions
) -> _Attempt:
    options = {"object": spec.shape} if spec.shape else None
    observation, info = environment.reset(seed=spec.seed, options=options)
    recorder = _Recorder(environment.task.spec.action_size, observation, info)
    outcome = None
    given.begin_attempt()
    try:
        actor.reset(environment, spec)
        while outcome is None:
            action = actor.act(observation)
            given.add(action)
            observation, reward, _, _, info = environment.step(action)
            recorder.add(observation, reward, info)
            outcome = OUTCOMES[info["outcome"]]
    except (PolicyFaultError, PolicyLoadError) as fault:
        record = EpisodeRecord(spec, Outcome.POLICY_FAULT, recorder.trace(), str(fault))
        return _Attempt(record, isinstance(fault, PolicyKilledError))
    return _Attempt(EpisodeRecord(spec, outcome, recorder.trace()), killed=False)


class _Recorder:
    """Collect what ``EpisodeTrace`` holds, step by step."""

    def __init__(self, action_size: int, observation: Observation, info: dict[str, Any]) -> None:
        self._action_size = action_size
        self._touch = [observation["touch"]]
        self._object_states = [info["object_state"]]
        self._steps: list[dict[str, Any]] = []
        self._rewards: list[float] = []

    def add(self, observation: Observation, reward: float, info: dict[str, Any]) -> None:
        self._touch.append(observation["touch"])
        self._object_states.append(info["object_state"])
        self._rewards.append(reward)
        self._steps.append(info)

    def trace(self) -> EpisodeTrace:
        actions = [step["action"] for step in self._steps]
        return EpisodeTrace(
            actions=np.array(actions, np.float32).reshape(-1, self._action_size),
            clipped=self._column("clipped", np.bool_),
            rewards=np.array(self._rewards, np.float32),
            ticks=self._column("ticks", np.int16),
            contact_ticks=self._column("contact_ticks", np.int16),
            onsets=self._column("onsets", np.int16),
            touch=np.array(self._touch, np.float32),
            object_state=np.array(self._object_states, np.float64),
            first_touch_tick=int(self._steps[-1]["first_touch_tick"]) if self._steps else -1,
        )

    def _column(self, name: str, dtype: type[np.generic]) -> NDArray[Any]:
        return np.array([step[name] for step in self._steps], dtype)
