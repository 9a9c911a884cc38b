"""The suites, and the episodes they consist of."""

from abc import ABC, abstractmethod
from dataclasses import replace

import numpy as np

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.protocol.seeds import episode_seed, suite_generator
from minitouch_bench.protocol.spec import SuiteSpec
from minitouch_bench.records import EpisodeSpec, Role
from minitouch_bench.shapegen.manifest import Shape, canonical_shape_set
from minitouch_bench.tasks.objects import CUBE


class Suite(SuiteSpec, ABC):
    """A suite that can name its episodes."""

    @abstractmethod
    def assign_object(self, spec: EpisodeSpec) -> EpisodeSpec:
        """Return the episode with its object filled in."""

    def episodes(self, *, exploration: bool) -> tuple[EpisodeSpec, ...]:
        """Return the episodes, task by task; with ``exploration`` those of that role too.

        Both roles face the same episodes. Playing has no exploration figure.
        """
        final = tuple(
            self.assign_object(EpisodeSpec(Role.FINAL, task, index, self._seed_of(task, index)))
            for task in self.tasks
            for index in range(self.episodes_per_task)
        )
        if not exploration:
            return final
        return final + tuple(
            replace(spec, role=Role.EXPLORATION) for spec in final if spec.task in GOAL_TASKS
        )

    def differences(self, tasks: tuple[str, ...], episodes: int, seed: int) -> tuple[str, ...]:
        """Return what makes a run with these settings unofficial, in words."""
        found = []
        if not self.rankable:
            found.append(f"suite {self.name}")
        if tasks != self.tasks:
            found.append(f"tasks {', '.join(tasks)} only")
        if episodes != self.episodes_per_task:
            found.append(f"{episodes} of {self.episodes_per_task} episodes a task")
        if seed != PROTOCOL.suite(self.name).seed:
            found.append(f"seed {seed}")
        return tuple(found)

    def _seed_of(self, task: str, index: int) -> int:
        return episode_seed(self.name, task, index, self.seed)


class StandardSuite(Suite):
    """Each task with its own object; where it draws from a shape set, the seed chooses."""

    def assign_object(self, spec: EpisodeSpec) -> EpisodeSpec:
        """Return the episode with its cube, its train shape, or nothing (Opening)."""
        objects = PROTOCOL.task(spec.task).default_objects
        if objects in ("", CUBE):
            return replace(spec, shape=objects)
        shapes = canonical_shape_set().split(objects)
        return _with_shape(
            spec, shapes[int(np.random.default_rng(spec.seed).integers(len(shapes)))]
        )


class NovelShapesSuite(Suite):
    """Each held-out shape once (even indices), beside as many train shapes (odd ones).

    The train shapes are drawn once, without replacement, from the protocol's name alone.
    """

    def assign_object(self, spec: EpisodeSpec) -> EpisodeSpec:
        """Return the episode with its shape."""
        shapes = canonical_shape_set()
        held_out = shapes.split("held-out")
        train = shapes.split("train")
        turn = (spec.index // 2) % len(held_out)
        if spec.index % 2 == 0:
            return _with_shape(spec, held_out[turn])
        order = suite_generator(self.name).permutation(len(train))
        return _with_shape(spec, train[int(order[turn])])


def _with_shape(spec: EpisodeSpec, shape: Shape) -> EpisodeSpec:
    return replace(spec, shape=shape.name, family=shape.family, split=shape.split)


SUITES: dict[str, Suite] = {
    spec.name: (NovelShapesSuite if spec.novel_shapes else StandardSuite)(**vars(spec))
    for spec in PROTOCOL.suites
}


def find_suite(name: str) -> Suite:
    """Return the suite called ``name``.

    Raises:
        UsageError: there is none.
    """
    if name not in SUITES:
        raise UsageError(f"no suite '{name}'; the suites are {', '.join(SUITES)}")
    return SUITES[name]


def parse_tasks(text: str | None, suite: Suite) -> tuple[str, ...]:
    """Return the tasks named in ``text``, separated by commas, in the suite's order.

    Raises:
        UsageError: one of them is not in the suite.
    """
    if text is None:
        return suite.tasks
    asked = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in asked if name not in suite.tasks]
    if unknown or not asked:
        raise UsageError(
            f"no task '{unknown[0] if unknown else text}' in suite {suite.name}; "
            f"its tasks are {', '.join(suite.tasks)}"
        )
    return tuple(name for name in suite.tasks if name in asked)
