"""One episode: the only place where a policy and a simulated world meet."""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from minitouch_bench import errors
from minitouch_bench.episode import EpisodeSpec, Observation, Outcome, PlayedEpisode, Role, Trace
from minitouch_bench.perturbation import AS_USUAL, DrawnConditions, Perturbation
from minitouch_bench.policies.policy import Policy, close_policy
from minitouch_bench.protocol.minitouch import senses_generator
from minitouch_bench.runs.plan import Plan
from minitouch_bench.simulation.observation import FORCES, SENSED_TOUCH
from minitouch_bench.tasks.environment import OBJECT, OUTCOMES, MiniTouchEnv

WorldOf = Callable[[str], MiniTouchEnv]
"""Returns the world that a task is played in: the scripted policy reads it."""


UNREACHABLE_S, UNREACHABLE_PAUSE_S = 30.0, 1.0
"""How long an episode waits for a policy server that cannot be reached, and between two tries."""


class PolicyMaker(Protocol):
    """Where a worker gets its policies from: a run's checkpoints, or its recorded actions."""

    @property
    def plan(self) -> Plan:
        """The plan of the run: it has the objects and the perturbation."""

    def make_policy(self, role: Role, world_of: WorldOf) -> Policy:
        """Return a new policy for the episodes of a role."""


class EpisodeRunner:
    """Runs episodes one after the other; it keeps a world per task and a policy per role."""

    def __init__(self, source: PolicyMaker) -> None:
        self._source = source
        self._worlds: dict[str, MiniTouchEnv] = {}
        self._policies: dict[Role, Policy] = {}

    def run(self, spec: EpisodeSpec) -> PlayedEpisode:
        """Run one episode; where its policy server cannot be reached, wait and begin it again.

        Raises:
            ServerUnreachableError: the server has not come back within UNREACHABLE_S.
        """
        if spec.role not in self._policies:
            self._policies[spec.role] = self._source.make_policy(spec.role, self._world_of)
        deadline = math.inf
        while True:
            try:
                return run_episode(self._world_of(spec.task), self._policies[spec.role], spec)
            except errors.ServerUnreachableError:
                now = time.monotonic()
                deadline = min(deadline, now + UNREACHABLE_S)
                if now >= deadline:
                    raise
                time.sleep(UNREACHABLE_PAUSE_S)

    def _world_of(self, task: str) -> MiniTouchEnv:
        if task not in self._worlds:
            plan = self._source.plan
            self._worlds[task] = MiniTouchEnv(
                task, plan.load_objects(), perturbation=plan.conditions_in_light()
            )
        return self._worlds[task]

    def close(self) -> None:
        """End the policies and the worlds."""
        for policy in self._policies.values():
            close_policy(policy)
        for environment in self._worlds.values():
            environment.close()


class AlteredSenses:
    """What a policy senses in one episode: in other light, with noise, late, with senses frozen.

    Forces stay within ``force_limit`` (N), as the observation space promises. ``drawn``: what the
    episode has of the perturbation. Until the first observation has its delay, it is given again.
    """

    def __init__(
        self,
        perturbation: Perturbation,
        seed: int,
        force_limit: float,
        drawn: DrawnConditions = AS_USUAL,
    ) -> None:
        self._perturbation = perturbation
        self._force_limit = force_limit
        self._rng = senses_generator(seed)
        self._latest: deque[Observation] = deque(maxlen=drawn.delay + 1)
        self._light = drawn.light
        self._first: Observation | None = None

    def alter(self, observation: Observation) -> Observation:
        """Return what the policy is given; the first call is the reset's observation."""
        if not self._perturbation.changes_senses:
            return observation
        self._latest.append(self._in_light_with_noise(observation))
        self._first = self._first or self._latest[0]
        image, touch = self._latest[0]["image"], self._latest[0]["touch"].copy()
        if "vision" in self._perturbation.without:
            image = self._first["image"]
        for sense in self._perturbation.without:
            if sense in SENSED_TOUCH:
                touch[SENSED_TOUCH[sense]] = self._first["touch"][SENSED_TOUCH[sense]]
        return {"image": image, "touch": touch}

    def _in_light_with_noise(self, observation: Observation) -> Observation:
        image, touch = observation["image"], observation["touch"].copy()
        if self._light != 1.0:
            image = (image * self._light).round().clip(0, 255).astype(np.uint8)
        if self._perturbation.noise:
            noisy = image + self._rng.normal(0.0, self._perturbation.noise, image.shape)
            image = noisy.round().clip(0, 255).astype(np.uint8)
        if self._perturbation.force_noise:
            forces = touch[FORCES]
            forces += self._rng.normal(0.0, self._perturbation.force_noise, forces.shape)
            forces.clip(-self._force_limit, self._force_limit, out=forces)
        return {"image": image, "touch": touch}


def run_episode(environment: MiniTouchEnv, policy: Policy, spec: EpisodeSpec) -> PlayedEpisode:
    """Run one episode from its seed to its end.

    A fault of the policy ends the episode, as a failed one. Any other exception is an
    infrastructure fault and passes through; an engine then runs the episode again. The policy's
    process being killed from outside is one, but not while it used much memory.
    """
    observation, info = environment.reset(seed=spec.seed, options={OBJECT: spec.shape})
    start = environment.start()
    touch, infos, rewards = [observation["touch"]], [info], []
    limit = environment.task.spec.force_limit
    senses = AlteredSenses(environment.perturbation, spec.seed, limit, environment.drawn)
    outcome, fault, is_late = None, "", False
    try:
        policy.reset(spec.policy_seed, spec.task)
        while outcome is None:
            action = policy.act(senses.alter(observation))
            observation, reward, _, _, info = environment.step(action)
            touch.append(observation["touch"])
            infos.append(info)
            rewards.append(reward)
            outcome = OUTCOMES[info["outcome"]]
    except (errors.PolicyFaultError, errors.PolicyLoadError) as error:
        outcome, fault = Outcome.POLICY_FAULT, str(error)
        # A timeout while loading is the cause of the error that is raised.
        is_late = isinstance(error.__cause__ or error, errors.PolicyTimeoutError)
    trace = _trace(environment.task.spec.action_size, touch, infos, rewards)
    return PlayedEpisode(spec, outcome, start, trace, fault, is_late)


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
