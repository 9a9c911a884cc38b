"""What plays a run: its policies, found and tried before any episode, or its recorded actions."""

import contextlib
import random
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import EpisodeSpec, Observation, Role
from minitouch_bench.errors import (
    PolicyFaultError,
    PolicyLoadError,
    ServerUnreachableError,
    UsageError,
)
from minitouch_bench.evaluation.engine import Note
from minitouch_bench.evaluation.rollout import WorldOf
from minitouch_bench.policies.formats import BUILT_IN, FORMATS
from minitouch_bench.policies.policy import (
    SANDBOXED,
    TO_REMEMBER,
    Isolation,
    IsolationOptions,
    Policy,
    PolicySource,
    zero_observation,
)
from minitouch_bench.policies.policy_process import effective_level, isolate
from minitouch_bench.policies.python_objects import keep_in_memory
from minitouch_bench.policies.scripted import ScriptedPolicy
from minitouch_bench.policies.sources import parse_source, trained_task
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.runs.actions import Actions
from minitouch_bench.runs.plan import Plan
from minitouch_bench.runs.run import Run
from minitouch_bench.text import printable


class RecordedPolicy:
    """Repeats the actions of each episode, by its task and seed, and fails where they end early."""

    _rest: Iterator[NDArray[np.float32]]

    def __init__(self, actions: Mapping[tuple[str, int], Actions]) -> None:
        self._actions = actions

    def reset(self, seed: int, task: str) -> None:
        """Begin the episode's actions."""
        self._rest = iter(self._actions[task, seed])

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the next action.

        Raises:
            PolicyFaultError: there is none: in the recorded run the policy broke off here.
        """
        try:
            return next(self._rest)
        except StopIteration:
            text = "the recorded actions end before the episode does"
            raise PolicyFaultError(text) from None


@dataclass(frozen=True)
class Recording:
    """The actions of episodes, float32 (T, A) each, as applied."""

    actions: Mapping[EpisodeSpec, Actions]
    plan: Plan

    @classmethod
    def of(cls, run: Run, specs: Iterable[EpisodeSpec]) -> "Recording":
        """Return the recorded actions of these episodes of a run.

        Raises:
            RunDirectoryError: they are missing, or their file is missing or damaged.
            UsageError: the objects of the run are not there, or have been changed.
        """
        run.plan.load_objects()
        return cls({spec: run.actions_of(spec.key) for spec in specs}, run.plan)

    def make_policy(self, role: Role, world_of: WorldOf) -> RecordedPolicy:
        """Return a policy that repeats the actions of a role."""
        return RecordedPolicy(
            {(s.task, s.policy_seed): a for s, a in self.actions.items() if s.role is role}
        )


@dataclass(frozen=True)
class PolicySetup:
    """What is to be played: a plan, its policies by role, and how they are isolated."""

    plan: Plan
    policy: PolicySource
    exploration: PolicySource | None = None
    isolation: IsolationOptions = SANDBOXED

    def sources(self) -> tuple[PolicySource, ...]:
        """Return the final policy, and the exploration policy where there is one."""
        return (self.policy,) if self.exploration is None else (self.policy, self.exploration)

    def keep_out_of(self, directory: Path) -> "PolicySetup":
        """Return the same policies, which cannot read a directory from their sandbox."""
        return replace(self, isolation=replace(self.isolation, private=str(directory.resolve())))

    def isolation_level(self) -> Isolation:
        """Return the weakest level at which a policy of the run is isolated.

        A server's own code does not run here: its client counts only where there is no other.
        """
        here = [one for one in self.sources() if one.kind != "remote"] or self.sources()
        levels = (effective_level(one, self.isolation.level) for one in here)
        return max(levels, key=list(Isolation).index)

    def make_policy(self, role: Role, world_of: WorldOf) -> Policy:
        """Return the policy of a role, isolated as asked."""
        source = self.policy if role is Role.FINAL else self.exploration
        assert source is not None
        if source.kind == "scripted":
            return ScriptedPolicy(world_of)
        return isolate(source, self.isolation)


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
    plan.load_objects()
    isolation = replace(isolation, limits=plan.limits)
    source = _find_policy(policy, plan.tasks, isolation, note, Role.FINAL)
    if name is not None:
        if not printable(name):
            raise UsageError("--name is empty: reports need a name of the policy")
        source = replace(source, name=name)
    explorer = None
    if exploration is not None:
        goals = tuple(task for task in plan.tasks if task in GOAL_TASKS)
        if not goals:
            raise UsageError("--exploration needs a task with a goal: " + ", ".join(GOAL_TASKS))
        explorer = _find_policy(exploration, goals, isolation, note, Role.EXPLORATION)
        if explorer.kind in BUILT_IN:
            raise UsageError(
                "--exploration is a policy that a training has explored with, which "
                f"'{explorer.kind}' is not: leave it out"
            )
    setup = PolicySetup(plan, source, explorer, isolation)
    for kind in dict.fromkeys(kind for one in setup.sources() for kind in one.kinds):
        if kind in FORMATS and FORMATS[kind].advice:
            note(FORMATS[kind].advice)
    if plan.conditions.changes_senses and "scripted" in {one.kind for one in setup.sources()}:
        raise UsageError("the scripted policy has no senses to change: it reads the simulator")
    return setup


def _find_policy(
    policy: object, tasks: tuple[str, ...], isolation: IsolationOptions, note: Note, role: Role
) -> PolicySource:
    if isinstance(policy, PolicySource):
        source = policy
    elif isinstance(policy, str | Path):
        source = parse_source(str(policy), role=role)
        if Path(policy).is_dir() and Path(source.target) != Path(policy):
            note(f"{source.target} is played")
        trained = trained_task(source)
        if trained is not None and {*tasks} != {trained}:
            note(f"{policy} was trained in {trained}: --tasks {trained} leaves out the other tasks")
    else:
        source = keep_in_memory(policy)
    source = replace(source, deterministic=role is Role.FINAL)
    level = effective_level(source, isolation.level)
    if source.kind == "remote" and level is not isolation.level:
        note(f"a policy server needs the network: its client has isolation {level}")
    for warning in try_policy(source, tasks, isolation):
        note(warning)
    return source


def try_policy(
    source: PolicySource, tasks: Sequence[str], options: IsolationOptions = SANDBOXED
) -> tuple[str, ...]:
    """Load every checkpoint of a source once and ask for an action, whose faults are passed over.

    One that serves several tasks is tried in that of the largest forces: a model of smaller ones
    is refused there.

    Returns:
        What loaders warn of, one line each.

    Raises:
        PolicyLoadError: it cannot be loaded or reset.
        IsolationError: this machine cannot isolate it as asked.
        MissingExtraError: an optional package is not installed.
        InfrastructureError: its process or its host was killed.
    """
    if source.kind == "scripted":
        return ()
    warnings, felt = [], zero_observation()
    felt["touch"] = np.ones_like(felt["touch"])
    hardest = max(tasks, key=lambda task: PROTOCOL.task(task).force_limit)
    with kept_generators(), contextlib.closing(isolate(source, options)) as tried:
        for task in tasks if source.parts else [hardest]:
            try:
                tried.reset(0, task)
            except PolicyFaultError as fault:
                raise PolicyLoadError(f"{tried.target} cannot be reset: {fault}") from fault
            except ServerUnreachableError as error:
                raise PolicyLoadError(str(error)) from error
            with contextlib.suppress(PolicyFaultError):
                tried.act(zero_observation())
                remembers = TO_REMEMBER in tried.warning and not np.array_equal(
                    tried.act(felt), tried.act(felt)
                )
                if tried.warning and not remembers:
                    warnings.append(f"{tried.target}: {tried.warning}")
    return tuple(warnings)


@contextlib.contextmanager
def kept_generators() -> Iterator[None]:
    """Leave the caller's generators and number of threads as they are: it may be a training."""
    states = random.getstate(), np.random.get_state()  # noqa: NPY002 - what a policy may use
    torch = sys.modules.get("torch")
    threads = torch.get_num_threads() if torch else 0
    devices = range(torch.cuda.device_count()) if torch and torch.cuda.is_initialized() else ()
    with torch.random.fork_rng(devices) if torch else contextlib.nullcontext():
        try:
            yield
        finally:
            random.setstate(states[0])
            np.random.set_state(states[1])  # noqa: NPY002
            if torch:
                torch.set_num_threads(threads)
