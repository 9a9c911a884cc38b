"""The policies of a run, and the actors that play its episodes with them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import EpisodeSpec, Role
from minitouch_bench.errors import PolicyFaultError, UsageError
from minitouch_bench.evaluation.engine import Note
from minitouch_bench.evaluation.rollout import Actor
from minitouch_bench.perturbation import UNPERTURBED, Perturbation
from minitouch_bench.policies.isolate import effective_level, isolate, try_policy
from minitouch_bench.policies.policy import (
    SANDBOXED,
    Isolation,
    IsolationOptions,
    Observation,
    Policy,
    close_policy,
    weakest,
)
from minitouch_bench.policies.python_objects import keep_in_memory
from minitouch_bench.policies.scripted import Controller, make_controller
from minitouch_bench.policies.sources import PolicySource, parse_source
from minitouch_bench.protocol.minitouch import GOAL_TASKS, TASK_NAMES, senses_generator
from minitouch_bench.runs.actions import Actions
from minitouch_bench.runs.plan import Plan
from minitouch_bench.simulation.observation import FORCES
from minitouch_bench.tasks.environment import MiniTouchEnv


class PolicyActor:
    """A policy that sees observations only."""

    def __init__(self, policy: Policy, perturbation: Perturbation = UNPERTURBED) -> None:
        self._policy = policy
        self._perturbation = perturbation
        self._senses: AlteredSenses | None = None

    def reset(self, environment: MiniTouchEnv, spec: EpisodeSpec) -> None:
        """Load the policy again and reset it with its seed."""
        self._policy.reset(spec.policy_seed, spec.task)
        if self._perturbation.change_the_senses:
            self._senses = AlteredSenses(self._perturbation, spec.seed)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Ask the policy."""
        if self._senses is not None:
            observation = self._senses.alter(observation)
        return self._policy.act(observation)

    def close(self) -> None:
        """End the policy's process."""
        close_policy(self._policy)


class AlteredSenses:
    """What a policy senses in one episode, with senses frozen and noise added."""

    def __init__(self, perturbation: Perturbation, seed: int) -> None:
        self._perturbation = perturbation
        self._rng = senses_generator(seed)
        self._first: Observation | None = None

    def alter(self, observation: Observation) -> Observation:
        """Return what the policy is given; the first call is the reset's observation."""
        self._first = self._first or observation
        image, touch = observation["image"], observation["touch"].copy()
        if "vision" in self._perturbation.without:
            image = self._first["image"]
        frozen = {"touch": slice(None), "forces": FORCES}
        for sense in self._perturbation.without:
            if sense in frozen:
                touch[frozen[sense]] = self._first["touch"][frozen[sense]]
        if self._perturbation.noise:
            noisy = image + self._rng.normal(0.0, self._perturbation.noise, image.shape)
            image = noisy.round().clip(0, 255).astype(np.uint8)
        if self._perturbation.force_noise:
            forces = touch[FORCES]
            touch[FORCES] += self._rng.normal(0.0, self._perturbation.force_noise, forces.shape)
        return {"image": image, "touch": touch}


class ScriptedActor:
    """The scripted policy, which sits beside the simulator because it reads it."""

    _controller: Controller

    def reset(self, environment: MiniTouchEnv, spec: EpisodeSpec) -> None:
        """Make a new controller."""
        self._controller = make_controller(environment)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Ask the controller, which looks past the observation."""
        return self._controller.act()

    def close(self) -> None:
        """Do nothing: there is no process."""


END_OF_RECORDING = "the recorded actions end before the episode does"
"""The fault of a replayed episode that its policy broke off."""


class RecordedActor:
    """Repeats the actions of each episode, and fails where they end too early."""

    _rest: Iterator[NDArray[np.float32]]

    def __init__(self, actions: Mapping[str, Actions]) -> None:
        self._actions = actions

    def reset(self, environment: MiniTouchEnv, spec: EpisodeSpec) -> None:
        """Begin the episode's actions."""
        self._rest = iter(self._actions[spec.key])

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the next action.

        Raises:
            PolicyFaultError: there is none.
        """
        try:
            return next(self._rest)
        except StopIteration:
            raise PolicyFaultError(END_OF_RECORDING) from None

    def close(self) -> None:
        """Do nothing: there is no process."""


@dataclass(frozen=True)
class Recording:
    """The actions of a run by the keys of its episodes, float32 (T, A) each, as applied."""

    actions: Mapping[str, Actions]
    perturbation: Perturbation = UNPERTURBED

    def make_actor(self, role: Role) -> RecordedActor:
        """Return an actor that repeats them."""
        return RecordedActor(self.actions)


@dataclass(frozen=True)
class PolicySetup:
    """What is to be played: a plan, its policies by role, and how they are isolated."""

    plan: Plan
    policy: PolicySource
    exploration: PolicySource | None = None
    isolation: IsolationOptions = SANDBOXED

    @property
    def perturbation(self) -> Perturbation:
        """The perturbation of the plan."""
        return self.plan.conditions

    def sources(self) -> tuple[PolicySource, ...]:
        """Return the final policy, and the exploration policy where there is one."""
        return (self.policy,) if self.exploration is None else (self.policy, self.exploration)

    def keep_out_of(self, directory: Path) -> "PolicySetup":
        """Return the same policies, which cannot read a directory from their sandbox."""
        return replace(self, isolation=replace(self.isolation, private=str(directory.resolve())))

    def isolation_level(self) -> Isolation:
        """Return the weakest level at which a policy of the run is isolated."""
        return weakest(effective_level(one, self.isolation.level) for one in self.sources())

    def make_actor(self, role: Role) -> Actor:
        """Return a new actor of a role; exploration policies act stochastically."""
        source = self.policy if role is Role.FINAL else self.exploration
        assert source is not None
        if source.kind == "scripted":
            return ScriptedActor()
        policy = isolate(source, self.isolation, deterministic=role is Role.FINAL)
        return PolicyActor(policy, self.perturbation)


def prepare_policies(
    policy: object,
    plan: Plan,
    isolation: IsolationOptions = SANDBOXED,
    note: Note = lambda _: None,
    *,
    exploration: object | None = None,
    name: str | None = None,
) -> PolicySetup:
    """Find the policies of a plan and load each once: a bad file is refused before any episode.

    A policy is what the command line takes, an object, or a ``PolicySource``. ``name`` is what
    reports call the policy; by default its own name. ``note`` takes a line for the user.
    Conditions and limits are those of the plan.

    Raises:
        UsageError: an option has no meaning here.
        PolicyError, IsolationError, MissingExtraError: a policy cannot be used.
    """
    if isolation.level is Isolation.NONE and not isolation.trust:
        raise UsageError("--isolation none runs the policy in this very process: add --trust")
    isolation = replace(isolation, limits=plan.limits)
    source = _find_policy(policy, plan.tasks, isolation, note, Role.FINAL)
    if name is not None:
        source = replace(source, name=name)
    explorer = None
    if exploration is not None:
        goals = tuple(task for task in plan.tasks if task in GOAL_TASKS)
        if not goals:
            raise UsageError("--exploration needs a task with a goal: " + ", ".join(GOAL_TASKS))
        explorer = _find_policy(exploration, goals, isolation, note, Role.EXPLORATION)
    setup = PolicySetup(plan, source, explorer, isolation)
    if plan.conditions.change_the_senses and "scripted" in {one.kind for one in setup.sources()}:
        raise UsageError("the scripted policy has no senses to change: it reads the simulator")
    return setup


def _find_policy(
    policy: object,
    tasks: tuple[str, ...],
    isolation: IsolationOptions,
    note: Note,
    role: Role,
) -> PolicySource:
    if isinstance(policy, PolicySource):
        source = policy
    elif isinstance(policy, str | Path):
        source = parse_source(str(policy), tasks, trust=isolation.trust, role=role)
    else:
        source = keep_in_memory(policy)
    level = effective_level(source, isolation.level)
    if source.kind == "remote" and level is not isolation.level:
        note(f"a policy server needs the network: its client has isolation {level}")
    if (
        source.name in TASK_NAMES
        and source.digest
        and not source.parts
        and {*tasks} - {source.name}
    ):
        note(
            f"{source.target} is named after {source.name} and plays {', '.join(tasks)}: "
            "choose --tasks, or give a directory with a file for each task"
        )
    for warning in try_policy(source, tasks, isolation, deterministic=role is Role.FINAL):
        note(warning)
    return source
