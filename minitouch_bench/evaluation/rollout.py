"""One episode: the only place where a policy and a simulated world meet."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.conditions import Conditions
from minitouch_bench.errors import PolicyFaultError, PolicyKilledError, PolicyLoadError
from minitouch_bench.files import MIB, open_plain, read_file
from minitouch_bench.policies.policy import Observation
from minitouch_bench.processes import MAX_ATTEMPTS
from minitouch_bench.records import EpisodeRecord, EpisodeSpec, EpisodeTrace, Outcome, Role
from minitouch_bench.tasks.environment import OBJECT, OUTCOMES, MiniTouchEnv
from minitouch_bench.units import given_path

NOT_REPEATED = "tried again, it did not repeat its actions"


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


class GivenActions:
    """The longest sequence of actions that any attempt at an episode gave.

    An attempt can fail for no fault of the policy: its process is killed, its worker dies, the
    run is interrupted. A policy could use another attempt for another try. So each action is in
    a file before it is applied, and stays there until the episode's record is kept.
    ``path`` names the file; None: only the attempts of this process are known.
    """

    def __init__(self, size: int, path: Path | None = None) -> None:
        self._given: list[bytes] = []
        self._count = 0
        self._file = -1
        if path is None:
            return
        self._file = open_plain(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        row = size * np.dtype(np.float32).itemsize
        content = read_file(path, MIB)
        whole = len(content) - len(content) % row  # a full disk can cut the last one short
        os.ftruncate(self._file, whole)
        self._given = [content[at : at + row] for at in range(0, whole, row)]

    def __enter__(self) -> "GivenActions":
        return self

    def __exit__(self, *_: object) -> None:
        if self._file >= 0:
            os.close(self._file)

    def begin_attempt(self) -> None:
        """Expect the first action again."""
        self._count = 0

    def add(self, action: NDArray[np.float32]) -> None:
        """Note the next action.

        Raises:
            PolicyFaultError: an earlier attempt gave another one here.
            OSError: the disk is full.
        """
        row = np.asarray(action, "<f4").tobytes()
        if self._count == len(self._given):
            if self._file >= 0:
                os.write(self._file, row)
            self._given.append(row)
        elif row != self._given[self._count]:
            raise PolicyFaultError(NOT_REPEATED)
        self._count += 1


class EpisodeRunner:
    """Runs episodes one after the other; ``attempts``: the folder of actions to be repeated."""

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
    for _ in range(MAX_ATTEMPTS):
        attempt = _attempt(environment, actor, spec, given)
        if not attempt.killed:
            break
    return attempt.record


class _Attempt(NamedTuple):
    record: EpisodeRecord
    killed: bool


def _attempt(
    environment: MiniTouchEnv, actor: Actor, spec: EpisodeSpec, given: GivenActions
) -> _Attempt:
    observation, info = environment.reset(seed=spec.seed, options={OBJECT: spec.shape})
    touch, infos, rewards = [observation["touch"]], [info], []
    outcome, fault = None, None
    given.begin_attempt()
    try:
        actor.reset(environment, spec)
        while outcome is None:
            action = actor.act(observation)
            given.add(action)
            observation, reward, _, _, info = environment.step(action)
            touch.append(observation["touch"])
            infos.append(info)
            rewards.append(reward)
            outcome = OUTCOMES[info["outcome"]]
    except (PolicyFaultError, PolicyLoadError) as error:
        outcome, fault = Outcome.POLICY_FAULT, error
    trace = _trace(environment.task.spec.action_size, touch, infos, rewards)
    record = EpisodeRecord(spec, outcome, trace, str(fault or ""))
    return _Attempt(record, isinstance(fault, PolicyKilledError))


def _trace(
    action_size: int,
    touch: Sequence[NDArray[np.float32]],
    infos: Sequence[Mapping[str, Any]],
    rewards: Sequence[float],
) -> EpisodeTrace:
    """Return what was measured; ``touch`` and ``infos`` begin with those of the reset."""
    steps = infos[1:]

    def column(name: str, dtype: type[np.generic]) -> NDArray[Any]:
        return np.array([step[name] for step in steps], dtype)

    return EpisodeTrace(
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
