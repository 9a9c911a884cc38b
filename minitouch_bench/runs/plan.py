"""What a run plays: the plan that its header holds, and the episodes that follow from it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import UNSET, Meta, UnsetType

from minitouch_bench.episode import Count, EpisodeSpec, Role, Seed, Sha256OrNone
from minitouch_bench.errors import UsageError
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.perturbation import UNPERTURBED, Perturbation
from minitouch_bench.protocol.limits import USUAL_LIMITS, PolicyLimits
from minitouch_bench.protocol.minitouch import (
    GOAL_TASKS,
    PROTOCOL,
    episode_seed,
    policy_seed,
    suite_generator,
)
from minitouch_bench.protocol.spec import CUBE, Split, SuiteSpec
from minitouch_bench.shapegen import manifest
from minitouch_bench.text import numbered

NAMED_IN_LABEL = 6
"""Chosen episodes that a label names; the rest are counted."""

NOVEL_SUITES = frozenset(suite.name for suite in PROTOCOL.suites if suite.novel_shapes)
"""Suites whose episodes face each held-out shape once, and as many train shapes."""

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
class PlannedObjects:
    """Objects in place of each task's own: ``shapes`` of one set, which episodes take in turn.

    ``source``: the folder of the set as it was given, and ``digest`` the set's; both are "" where
    the objects come with this package.
    """

    name: str
    shapes: Annotated[tuple[str, ...], Meta(min_length=1)]
    source: str = field(compare=False)
    digest: Sha256OrNone

    @classmethod
    def of(cls, chosen: manifest.Objects) -> "PlannedObjects":
        """Return the objects that a user names.

        Raises:
            UsageError: there are no such objects, they are of several sets, or their set has been
                changed since it was read.
        """
        if chosen == CUBE:
            return cls(CUBE, (CUBE,), "", "")
        shapes = manifest.choose_shapes(chosen)
        folders = {shape.pack.parent for shape in shapes}
        if len(folders) > 1:
            raise UsageError("the objects of a run are shapes of one set, not of several")
        known = manifest.load_shape_set(*folders)
        if not {*shapes} <= {*known.shapes}:
            raise UsageError(f"{known.path} has been changed since its shapes were read")
        source = chosen if isinstance(chosen, str) else str(known.path)
        name, names = Path(source).resolve().name, tuple(shape.name for shape in shapes)
        if shapes != known.shapes and not isinstance(chosen, str | manifest.ShapeSet):
            name = first_of(names, NAMED_IN_LABEL)
        if known.digest != PROTOCOL.shapes:
            return cls(name, names, source, known.digest)
        return cls(manifest.ALL if shapes == known.shapes else name, names, "", "")

    @property
    def are_listed(self) -> bool:
        """Whether single shapes were named, as only Python can."""
        is_set = self.name in (CUBE, Path(self.source).name)
        return not is_set and self.name == first_of(self.shapes, NAMED_IN_LABEL)

    def mistake(self, tasks: Sequence[str]) -> str:
        """Return why the tasks cannot be played with these objects, or ""."""
        if fixed := [task for task in tasks if not PROTOCOL.task(task).default_objects]:
            return f"{fixed[0]} has no object to choose"
        here = {CUBE, *(shape.name for shape in manifest.canonical_shape_set().shapes)}
        return "" if self.source or here.issuperset(self.shapes) else "they are not known here"

    def __str__(self) -> str:
        return f"{self.name} {self.digest[:12]}".rstrip()


@dataclass(frozen=True)
class Plan:
    """What fixes the episodes of a run and how they are played, known before the first one.

    ``tasks`` in the suite's order; ``episodes`` per task. ``chosen`` names the episodes that are
    played, as in "pushing/17", where they are not every one. ``limits``: the policy's time and
    memory. ``objects``: those in place of the tasks' own, unset where there are none.
    """

    suite: str
    tasks: tuple[str, ...]
    episodes: Count
    seed: Seed
    chosen: tuple[str, ...] = ()
    conditions: Perturbation = UNPERTURBED
    limits: PolicyLimits = USUAL_LIMITS
    objects: PlannedObjects | UnsetType = UNSET

    def conditions_in_light(self) -> Perturbation:
        """Return the conditions with the light that the suite has, unless they name another."""
        light = next((one.light for one in PROTOCOL.suites if one.name == self.suite), 1.0)
        if light == 1.0 or self.conditions.light is not None:
            return self.conditions
        return msgspec.structs.replace(self.conditions, light=(light, light))

    @lru_cache(maxsize=8)  # noqa: B019  a plan is a value, and of few runs
    def specs(self, *, exploration: bool = False) -> tuple[EpisodeSpec, ...]:
        """Return the episodes, task by task; with ``exploration`` those of that role too.

        Both roles face the same episodes. Playing has no exploration metric.
        """
        wanted = frozenset(self.chosen)
        final = tuple(
            self._episode(task, index)
            for task in self.tasks
            for index in range(self.episodes)
            if not wanted or f"{task}/{index}" in wanted
        )
        if not exploration:
            return final
        return final + tuple(
            replace(spec, role=Role.EXPLORATION) for spec in final if spec.task in GOAL_TASKS
        )

    def _episode(self, task: str, index: int) -> EpisodeSpec:
        """Return an episode with its object: one of those chosen, the task's own, or a shape."""
        words = (self.suite, task, index, self.seed)
        spec = EpisodeSpec(Role.FINAL, task, index, episode_seed(*words), policy_seed(*words))
        objects = PROTOCOL.task(task).default_objects
        if self.objects:
            name = self.objects.shapes[index % len(self.objects.shapes)]
            if self.objects.source or name == CUBE:
                return replace(spec, shape=name)
            shape = manifest.canonical_shape_set().by_name(name)
        elif self.suite in NOVEL_SUITES:
            shape = _novel_shape(self.suite, index)
        elif objects in ("", CUBE):
            return replace(spec, shape=objects)
        else:
            shapes = manifest.canonical_shape_set().split(objects)
            shape = shapes[int(np.random.default_rng(spec.seed).integers(len(shapes)))]
        return replace(spec, shape=shape.name, family=shape.family, split=shape.split)

    def rules(self) -> dict[str, str]:
        """Return this installation's digest of the protocol for each task."""
        return {task: PROTOCOL.task_digest(task, self.suite) for task in self.tasks}

    def why_unofficial(self) -> tuple[str, ...]:
        """Return what differs from an official run of the suite, in words."""
        suite = PROTOCOL.suite(self.suite)
        reasons = [] if suite.rankable else [f"suite {suite.name}"]
        if self.chosen:
            reasons.append(f"episodes {first_of(self.chosen, NAMED_IN_LABEL)} only")
        elif self.tasks != suite.tasks:
            reasons.append(f"tasks {', '.join(self.tasks)} only")
        if self.episodes != suite.episodes_per_task:
            reasons.append(f"{self.episodes} of {suite.episodes_per_task} episodes per task")
        if self.seed != suite.seed:
            reasons.append(f"seed {self.seed}")
        for name, words in LIMITS_IN_WORDS.items():
            if (limit := getattr(self.limits, name)) != getattr(USUAL_LIMITS, name):
                reasons.append(words.format(limit))
        return (*reasons, *self.changes_in_words())

    def load_objects(self) -> manifest.ShapeSet | None:
        """Return the user's set of objects, None where the objects come with this package.

        Raises:
            UsageError: it is not where it was, or has been changed.
        """
        if not self.objects or not self.objects.source:
            return None
        try:
            known = manifest.load_shape_set(self.objects.source)
        except UsageError as error:
            what = f"the objects of the run are gone: {error}.\nPut the set {self.objects} there"
            raise UsageError(what) from error
        if known.digest != self.objects.digest:
            raise UsageError(
                f"{self.objects.source} is not the set of the run: its digest is "
                f"{known.digest[:12]}, the run's objects are {self.objects}"
            )
        return known

    def changes_in_words(self) -> tuple[str, ...]:
        """Return what differs from the protocol in the objects, the senses and the world."""
        objects = (f"objects {self.objects}",) if self.objects else ()
        return (*objects, *self.conditions.in_words())

    def differences(self) -> tuple[str, ...]:
        """Return what differs from the suite in the episodes, and ``changes_in_words``; short."""
        suite = PROTOCOL.suite(self.suite)
        is_usual = self.tasks == _usual_tasks(suite, with_objects=bool(self.objects))
        words = list(self.chosen or (() if is_usual else self.tasks))
        if self.episodes != suite.episodes_per_task:
            words.append(numbered(self.episodes, "episode"))
        if self.seed != suite.seed:
            words.append(f"seed {self.seed}")
        return (*words, *self.changes_in_words())

    def as_options(self) -> tuple[str, ...]:
        """Return the options of ``evaluate`` that make this plan."""
        suite = PROTOCOL.suite(self.suite)
        words = ["--suite", self.suite]
        for key in self.chosen:
            words += ["--episodes-from", key]
        if not self.chosen and self.tasks != suite.tasks:
            words += ["--tasks", ",".join(self.tasks)]
        if self.episodes != suite.episodes_per_task:  # never of chosen episodes
            words += ["--episodes", str(self.episodes)]
        if self.seed != suite.seed:
            words += ["--seed", str(self.seed)]
        if self.objects:
            words += ["--objects", self.objects.source or self.objects.name]
        return (*words, *self.conditions.as_options(), *self.limits.as_options())

    def mistake(self) -> str:
        """Return why nobody can have asked for this plan, "" if somebody can."""
        tasks, episodes = (None, None) if self.chosen else (self.tasks, self.episodes)
        try:
            made = make_plan(
                self.suite, tasks, episodes, self.seed, self.chosen,
                conditions=self.conditions, limits=self.limits,
            )  # fmt: skip
        except UsageError as error:
            return str(error)
        if replace(made, objects=self.objects) != self:
            return "its tasks or episodes are not those of the suite, in its order"
        return self.objects.mistake(self.tasks) if self.objects else ""


def _usual_tasks(suite: SuiteSpec, *, with_objects: bool) -> tuple[str, ...]:
    """Return the tasks of a suite; ``with_objects`` those that have an object to choose."""
    return tuple(
        task for task in suite.tasks if not with_objects or PROTOCOL.task(task).default_objects
    )


def _novel_shape(suite: str, index: int) -> manifest.Shape:
    """Take each held-out shape once (even indices), and as many drawn train shapes."""
    shapes = manifest.canonical_shape_set()
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
    objects: manifest.Objects | None = None,
) -> Plan:
    """Return a plan of what a user asks for; None and () for what the suite has.

    ``episodes_from``: only these episodes, as in ("pushing/3,17", "opening/0"), in place of tasks
    and a number. With ``objects``, the tasks are by default those that have an object to choose.

    Raises:
        UsageError: there is no such suite, task or episode, or there are no such objects.
    """
    known = PROTOCOL.suite(suite)
    chosen = choose_episodes(episodes_from, known)
    if chosen and (tasks is not None or episodes is not None):
        raise UsageError("--episodes-from names tasks and episodes: leave out --tasks, --episodes")
    number = known.episodes_per_task if episodes is None else episodes
    seed = known.seed if seed is None else seed
    if not 1 <= number <= MAX_EPISODES or seed < 0:
        raise UsageError(f"episodes can be 1 to {MAX_EPISODES:,}, and a seed 0 or more")
    if conditions.light == (known.light, known.light):
        conditions = msgspec.structs.replace(conditions, light=None)
    if chosen:
        tasks = [key.partition("/")[0] for key in chosen]
    elif tasks is None:
        tasks = _usual_tasks(known, with_objects=objects is not None)
    tasks = choose_tasks(tasks, known)
    planned = UNSET if objects is None else PlannedObjects.of(objects)
    if planned and (mistake := planned.mistake(tasks)):
        raise UsageError(f"{mistake}: leave it out, or leave out --objects")
    return Plan(suite, tasks, number, seed, chosen, conditions, limits, planned)


def choose_tasks(asked: Sequence[str], suite: SuiteSpec) -> tuple[str, ...]:
    """Return the tasks of a suite that are asked for, in the suite's order.

    Raises:
        UsageError: one of them is not in the suite.
    """
    unknown = [name for name in asked if name not in suite.tasks]
    if unknown or not asked:
        raise UsageError(
            f"no task '{unknown[0] if unknown else ''}' in suite {suite.name}; "
            f"its tasks are {', '.join(suite.tasks)}{suite.lacks and f' ({suite.lacks})'}"
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
