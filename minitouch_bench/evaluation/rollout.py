"""One episode: the only place where a policy and a simulated world meet."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import EpisodeSpec, Outcome, PlayedEpisode, Role, Trace
from minitouch_bench.errors import (
    InfrastructureError,
    PolicyFaultError,
    PolicyLoadError,
    PolicyTimeoutError,
)
from minitouch_bench.perturbation import Perturbation
from minitouch_bench.policies.policy import Observation
from minitouch_bench.processes import run_in_workers
from minitouch_bench.tasks.environment import OBJECT, OUTCOMES, MiniTouchEnv


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
    def perturbation(self) -> Perturbation:
        """The perturbation of the run's episodes."""

    def make_actor(self, role: Role) -> Actor:
        """Return a new actor for the episodes of a role."""


class EpisodeRunner:
    """Runs episodes one after the other; it keeps an environment per task, an actor per role."""

    def __init__(self, source: ActorSource) -> None:
        self._source = source
        self._environments: dict[str, MiniTouchEnv] = {}
        self._actors: dict[Role, Actor] = {}

    def run(self, spec: EpisodeSpec) -> PlayedEpisode:
        """Run one episode."""
        if spec.task not in self._environments:
            self._environments[spec.task] = MiniTouchEnv(
                spec.task, perturbation=self._source.perturbation
            )
        if spec.role not in self._actors:
            self._actors[spec.role] = self._source.make_actor(spec.role)
        environment, actor = self._environments[spec.task], self._actors[spec.role]
        return run_episode(environment, actor, spec)

    def close(self) -> None:
        """End the policies and the worlds."""
        for actor in self._actors.values():
            actor.close()
        for environment in self._environments.values():
            environment.close()


def run_episode(environment: MiniTouchEnv, actor: Actor, spec: EpisodeSpec) -> PlayedEpisode:
    """Run one episode from its seed to its end.

    A fault of the policy ends the episode, as a failed one. Any other exception is an
    infrastructure fault and passes through; an engine then runs the episode again. The policy's
    process being killed from outside, perhaps by a machine out of memory, is one.
    """
    observation, info = environment.reset(seed=spec.seed, options={OBJECT: spec.shape})
    touch, infos, rewards = [observation["touch"]], [info], []
    outcome, fault, is_late = None, "", False
    try:
        actor.reset(environment, spec)
        while outcome is None:
            action = actor.act(observation)
            observation, reward, _, _, info = environment.step(action)
            touch.append(observation["touch"])
            infos.append(info)
            rewards.append(reward)
            outcome = OUTCOMES[info["outcome"]]
    except (PolicyFaultError, PolicyLoadError) as error:
        outcome, fault = Outcome.POLICY_FAULT, str(error)
        # A timeout while loading is the cause of the error that is raised.
        is_late = isinstance(error.__cause__ or error, PolicyTimeoutError)
    trace = _trace(environment.task.spec.action_size, touch, infos, rewards)
    return PlayedEpisode(spec, outcome, trace, fault, is_late)


def _trace(
    action_size: int,
    touch: Sequence[NDArray[np.float32]],
    infos: Sequence[Mapping[str, Any]],
    rewards: Sequence[float],
) -> Trace:
    """Return what was measured; ``touch`` and ``infos`` begin with those of the reset."""
    steps = infos[1:]

    def column(name: str, dtype: type[np.generic]) -> NDArray[Any]:
        return np.array([step[name] for step in steps], dtype)

    return Trace(
        actions=column("action", np.float32).reshape(-1, action_size),
        clipped=column("clipped", np.bool_),
        rewards=np.array(rewards, np.float32),
        ticks=column("ticks", np.int16),
        contact_ticks=column("contact_ticks", np.int16),
        onsets=column("onsets", np.int16),
        touch=np.array(touch, np.float32),
        object_state=np.array([info["object_state"] for info in infos], np.float64),
        first_touch_tick=int(steps[-1]["first_touch_tick"]) if steps else -1,
    )


class LocalEngine:
    """Runs each episode in one of ``workers`` processes."""

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(self, source: ActorSource, specs: Sequence[EpisodeSpec]) -> Iterator[PlayedEpisode]:
        """Yield records as episodes end; a worker that dies is replaced, its episode retried.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy.
        """
        records = run_in_workers(
            partial(_run_episode, EpisodeRunner(source)),
            specs,
            self.workers,
            name=lambda spec: f"episode {spec.key}",
        )
        with contextlib.closing(records):
            for _, record in records:
                yield record


def _run_episode(runner: EpisodeRunner, spec: EpisodeSpec) -> PlayedEpisode:
    """Run an episode in a worker. A policy's fault is a record: any error is the machine's."""
    try:
        return runner.run(spec)
    except InfrastructureError:
        raise
    except Exception as error:
        raise InfrastructureError(f"{type(error).__name__}: {error}") from error
