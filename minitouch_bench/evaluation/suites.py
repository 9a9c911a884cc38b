"""The suites, and the episodes they consist of."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from msgspec import UNSET

from minitouch_bench.errors import UsageError
from minitouch_bench.policies.limits import USUAL_LIMITS
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.protocol.seeds import episode_seed, policy_seed, suite_generator
from minitouch_bench.protocol.spec import CUBE, SuiteSpec
from minitouch_bench.records import IN_MEMORY, EpisodeSpec, Role, RunHeader
from minitouch_bench.shapegen.manifest import Shape, canonical_shape_set

NAMED = 6
"""Chosen episodes that a label names; the rest are counted."""


class Suite(SuiteSpec):
    """A suite that can name its episodes."""

    def episodes(self, *, exploration: bool, chosen: Sequence[str] = ()) -> tuple[EpisodeSpec, ...]:
        """Return the episodes, task by task; with ``exploration`` those of that role too.

        Both roles face the same episodes. Playing has no exploration figure. ``chosen`` names
        those to return, as in "pushing/17"; without it all.
        """
        wanted = frozenset(chosen)
        final = tuple(
            self.assign_object(self._spec(task, index))
            for task in self.tasks
            for index in range(self.episodes_per_task)
            if not wanted or f"{task}/{index}" in wanted
        )
        if not exploration:
            return final
        return final + tuple(
            replace(spec, role=Role.EXPLORATION) for spec in final if spec.task in GOAL_TASKS
        )

    def _spec(self, task: str, index: int) -> EpisodeSpec:
        words = (self.name, task, index, self.seed)
        return EpisodeSpec(Role.FINAL, task, index, episode_seed(*words), policy_seed(*words))

    def assign_object(self, spec: EpisodeSpec) -> EpisodeSpec:
        """Return the episode with its object filled in.

        That is the task's own cube or nothing (Opening); where the task draws from a shape set,
        the seed chooses.
        """
        if self.novel_shapes:
            return self._assign_novel_shape(spec)
        objects = PROTOCOL.task(spec.task).default_objects
        if objects in ("", CUBE):
            return replace(spec, shape=objects)
        shapes = canonical_shape_set().split(objects)
        drawn = int(np.random.default_rng(spec.seed).integers(len(shapes)))
        return _with_shape(spec, shapes[drawn])

    def _assign_novel_shape(self, spec: EpisodeSpec) -> EpisodeSpec:
        """Take each held-out shape once (even indices), beside as many train shapes (odd ones).

        The train shapes are drawn once, without replacement, from the protocol's name alone.
        """
        shapes = canonical_shape_set()
        held_out, train = shapes.split("held-out"), shapes.split("train")
        turn = (spec.index // 2) % len(held_out)
        if spec.index % 2 == 0:
            return _with_shape(spec, held_out[turn])
        order = suite_generator(self.name).permutation(len(train))
        return _with_shape(spec, train[int(order[turn])])


def _with_shape(spec: EpisodeSpec, shape: Shape) -> EpisodeSpec:
    return replace(spec, shape=shape.name, family=shape.family, split=shape.split)


SUITES = {spec.name: Suite(**vars(spec)) for spec in PROTOCOL.suites}


def find_suite(name: str) -> Suite:
    """Return the suite called ``name``.

    Raises:
        UsageError: there is none.
    """
    if name not in SUITES:
        raise UsageError(f"no suite '{name}'; the suites are {', '.join(SUITES)}")
    return SUITES[name]


def choose_tasks(asked: Sequence[str] | None, suite: Suite) -> tuple[str, ...]:
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


def choose_episodes(asked: Sequence[str], suite: Suite) -> tuple[str, ...]:
    """Return the names of the episodes asked for, as in "pushing/3,17", in the suite's order.

    Raises:
        UsageError: one of them is not in the suite.
    """
    found = set()
    for text in asked:
        task, _, indices = text.partition("/")
        choose_tasks([task], suite)
        for index in map(str.strip, indices.split(",")):
            if not re.fullmatch(r"[0-9]{1,8}", index) or int(index) >= suite.episodes_per_task:
                raise UsageError(
                    f"no episode '{task}/{index}' in suite {suite.name}; "
                    f"it has {task}/0 to {task}/{suite.episodes_per_task - 1}"
                )
            found.add((suite.tasks.index(task), int(index)))
    return tuple(f"{suite.tasks[task]}/{index}" for task, index in sorted(found))


def why_unofficial(header: RunHeader, suite: Suite) -> tuple[str, ...]:
    """Return what makes a run of a suite unofficial, in words."""
    found = []
    if not suite.rankable:
        found.append(f"suite {suite.name}")
    if header.chosen:
        more = f" and {len(header.chosen) - NAMED} more" if len(header.chosen) > NAMED else ""
        found.append(f"episodes {', '.join(header.chosen[:NAMED])}{more} only")
    elif header.tasks != suite.tasks:
        found.append(f"tasks {', '.join(header.tasks)} only")
    if header.episodes != suite.episodes_per_task:
        found.append(f"{header.episodes} of {suite.episodes_per_task} episodes per task")
    if header.seed != suite.seed:
        found.append(f"seed {header.seed}")
    if header.act_timeout_s != USUAL_LIMITS.act_timeout_s:
        found.append(f"{header.act_timeout_s:g} s per action")
    if header.episode_timeout_s is not UNSET:
        found.append(f"{header.episode_timeout_s:g} s per episode")
    if header.conditions is not UNSET:
        found += header.conditions.in_words()
    policies = [policy for policy in (header.policy, header.exploration) if policy is not None]
    if any(policy.kind == IN_MEMORY for policy in policies):
        found.append("policy in memory, beside the simulator")
    return tuple(found)
