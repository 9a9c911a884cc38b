"""What a run plays: the plan that its header holds, and the episodes that follow from it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from minitouch_bench.episode import Count, EpisodeSpec, Role, Seed
from minitouch_bench.errors import UsageError
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.perturbation import UNPERTURBED, USUAL_LIMITS, Perturbation, PolicyLimits
from minitouch_bench.protocol.minitouch import (
    GOAL_TASKS,
    PROTOCOL,
    SUITE_NAMES,
    episode_seed,
    policy_seed,
    suite_generator,
)
from minitouch_bench.protocol.spec import CUBE, Split, SuiteSpec
from minitouch_bench.shapegen.manifest import Shape, canonical_shape_set

NAMED = 6
"""Chosen episodes that a label names; the rest are counted."""

LIMITS_IN_WORDS = {
    "act_timeout_s": "{:g} s per action",
    "episode_timeout_s": "{:g} s per episode",
    "load_timeout_s": "{:g} s to load",
    "memory_mb": "{} MiB of memory",
}


def first_of(names: Sequence[str], most: int) -> str:
    """Return the first names, at most so many, and the number of the others, in words."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


@dataclass(frozen=True)
class Plan:
    """What fixes the episodes of a run and how they are played, known before the first one.

    ``tasks`` in the suite's order; ``episodes`` per task. ``chosen`` names the episodes that are
    played, as in "pushing/17", where they are not every one. ``limits``: the policy's time and
    memory.
    """

    suite: str
    tasks: tuple[str, ...]
    episodes: Count
    seed: Seed
    chosen: tuple[str, ...] = ()
    conditions: Perturbation = UNPERTURBED
    limits: PolicyLimits = USUAL_LIMITS

    @lru_cache(maxsize=8)  # noqa: B019  a plan is a value, and of few runs
    def specs(self, *, exploration: bool = False) -> tuple[EpisodeSpec, ...]:
        """Return the episodes, in the suite's order; with ``exploration`` those of that role too.

        Raises:
            UsageError: there is no such suite.
        """
        suite = replace(
            PROTOCOL.suite(self.suite),
            tasks=self.tasks,
            episodes_per_task=self.episodes,
            seed=self.seed,
        )
        return suite_episodes(suite, exploration=exploration, chosen=self.chosen)

    def rules(self) -> dict[str, str]:
        """Return this installation's digest of the protocol for each task."""
        return {task: PROTOCOL.task_digest(task, self.suite) for task in self.tasks}

    def why_unofficial(self) -> tuple[str, ...]:
        """Return what differs from an official run of the suite, in words."""
        suite = PROTOCOL.suite(self.suite)
        reasons = [] if suite.rankable else [f"suite {suite.name}"]
        if self.chosen:
            reasons.append(f"episodes {first_of(self.chosen, NAMED)} only")
        elif self.tasks != suite.tasks:
            reasons.append(f"tasks {', '.join(self.tasks)} only")
        if self.episodes != suite.episodes_per_task:
            reasons.append(f"{self.episodes} of {suite.episodes_per_task} episodes per task")
        if self.seed != suite.seed:
            reasons.append(f"seed {self.seed}")
        for name, words in LIMITS_IN_WORDS.items():
            if (limit := getattr(self.limits, name)) != getattr(USUAL_LIMITS, name):
                reasons.append(words.format(limit))
        return (*reasons, *self.conditions.in_words())

    def as_options(self) -> tuple[str, ...]:
        """Return the options of ``evaluate`` that make this plan."""
        suite = PROTOCOL.suite(self.suite)
        words = ["--suite", self.suite]
        if self.chosen:
            words += [word for key in self.chosen for word in ("--episodes-from", key)]
        else:
            if self.tasks != suite.tasks:
                words += ["--tasks", ",".join(self.tasks)]
            if self.episodes != suite.episodes_per_task:
                words += ["--episodes", str(self.episodes)]
        if self.seed != suite.seed:
            words += ["--seed", str(self.seed)]
        return (*words, *self.conditions.as_options(), *self.limits.as_options())

    def mistake(self) -> tuple[str, str]:
        """Return the first field that no plan of this protocol can have, and why; or two ""."""
        if self.suite not in SUITE_NAMES:
            return "suite", f"there is no suite '{self.suite}'"
        suite = PROTOCOL.suite(self.suite)
        if not self.tasks or tuple(t for t in suite.tasks if t in self.tasks) != self.tasks:
            return "tasks", f"they are not tasks of {suite.name} in its order"
        if not 0 < self.episodes <= MAX_EPISODES:
            return "episodes", f"a run has 1 to {MAX_EPISODES} per task"
        if self.chosen and not self._chooses(replace(suite, episodes_per_task=self.episodes)):
            return "chosen", f"they are not episodes of {suite.name} in its order"
        return "", ""

    def _chooses(self, suite: SuiteSpec) -> bool:
        """Tell whether the chosen are episodes of every task of the plan, each once, in order."""
        try:
            return choose_episodes(self.chosen, suite) == self.chosen and (
                choose_tasks(_tasks_of(self.chosen), suite) == self.tasks
            )
        except UsageError:
            return False


def suite_episodes(
    suite: SuiteSpec, *, exploration: bool = False, chosen: Sequence[str] = ()
) -> tuple[EpisodeSpec, ...]:
    """Return the episodes of a suite, task by task; with ``exploration`` those of that role too.

    Both roles face the same episodes. Playing has no exploration metric. ``chosen`` names
    those to return, as in "pushing/17"; without it all.
    """
    wanted = frozenset(chosen)
    final = tuple(
        _episode(suite, task, index)
        for task in suite.tasks
        for index in range(suite.episodes_per_task)
        if not wanted or f"{task}/{index}" in wanted
    )
    if not exploration:
        return final
    return final + tuple(
        replace(spec, role=Role.EXPLORATION) for spec in final if spec.task in GOAL_TASKS
    )


def _episode(suite: SuiteSpec, task: str, index: int) -> EpisodeSpec:
    """Return an episode with its object: the task's own, or a shape of the set."""
    words = (suite.name, task, index, suite.seed)
    spec = EpisodeSpec(Role.FINAL, task, index, episode_seed(*words), policy_seed(*words))
    objects = PROTOCOL.task(task).default_objects
    if suite.novel_shapes:
        shape = _novel_shape(suite.name, index)
    elif objects in ("", CUBE):
        return replace(spec, shape=objects)
    else:
        shapes = canonical_shape_set().split(objects)
        shape = shapes[int(np.random.default_rng(spec.seed).integers(len(shapes)))]
    return replace(spec, shape=shape.name, family=shape.family, split=shape.split)


def _novel_shape(suite: str, index: int) -> Shape:
    """Take each held-out shape once (even indices), and as many drawn train shapes."""
    shapes = canonical_shape_set()
    held_out, train = shapes.split(Split.HELD_OUT), shapes.split(Split.TRAIN)
    turn = (index // 2) % len(held_out)
    if index % 2 == 0:
        return held_out[turn]
    return train[int(suite_generator(suite).permutation(len(train))[turn])]


def make_plan(
    suite: str,
    tasks: Sequence[str] | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    episodes_from: Sequence[str] = (),
    *,
    conditions: Perturbation = UNPERTURBED,
    limits: PolicyLimits = USUAL_LIMITS,
) -> Plan:
    """Return a plan of what a user asks for; None and () for what the suite has.

    ``episodes_from``: only these episodes, as in ("pushing/3,17", "opening/0"), in place of tasks
    and a number.

    Raises:
        UsageError: there is no such suite, task or episode.
    """
    known = PROTOCOL.suite(suite)
    chosen = choose_episodes(episodes_from, known)
    if chosen and (tasks is not None or episodes is not None):
        raise UsageError("--episodes-from names tasks and episodes: leave out --tasks, --episodes")
    number = known.episodes_per_task if episodes is None else episodes
    if not 1 <= number <= MAX_EPISODES or (seed or 0) < 0:
        raise UsageError(f"episodes can be 1 to {MAX_EPISODES:,}, and a seed 0 or more")
    return Plan(
        suite,
        choose_tasks(_tasks_of(chosen) or tasks, known),
        number,
        known.seed if seed is None else seed,
        chosen,
        conditions,
        limits,
    )


def _tasks_of(chosen: Sequence[str]) -> list[str]:
    return [key.partition("/")[0] for key in chosen]


def choose_tasks(asked: Sequence[str] | None, suite: SuiteSpec) -> tuple[str, ...]:
    """Return the tasks of a suite that are asked for, in the suite's order; None for all.

    Raises:
        UsageError: one of them is not in the suite.
    """
    if asked is None:
        return suite.tasks
    unknown = [name for name in asked if name not in suite.tasks]
    if unknown or not asked:
        raise UsageError(
            f"no task '{unknown[0] if unknown else ''}' in suite {suite.name}; "
            f"its tasks are {', '.join(suite.tasks)}"
        )
    return tuple(name for name in suite.tasks if name in asked)


def choose_episodes(asked: Sequence[str], suite: SuiteSpec) -> tuple[str, ...]:
    """Return the names of the episodes asked for, as in "pushing/3,17", in the suite's order.

    Raises:
        UsageError: one of them is not in the suite.
    """
    positions = set()
    for text in asked:
        task, _, indices = text.partition("/")
        choose_tasks([task], suite)
        for index in map(str.strip, indices.split(",")):
            if not re.fullmatch(r"[0-9]{1,8}", index) or int(index) >= suite.episodes_per_task:
                raise UsageError(
                    f"no episode '{task}/{index}' in suite {suite.name}; "
                    f"it has {task}/0 to {task}/{suite.episodes_per_task - 1}"
                )
            positions.add((suite.tasks.index(task), int(index)))
    return tuple(f"{suite.tasks[task]}/{index}" for task, index in sorted(positions))
