"""The suites, and the episodes they consist of."""

from dataclasses import dataclass, replace

import numpy as np

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.seeds import episode_seed
from minitouch_bench.records import GOAL_TASKS, TASK_NAMES, EpisodeSpec, Role
from minitouch_bench.tasks.registration import object_names

OFFICIAL_SEED = 0


@dataclass(frozen=True)
class Suite:
    """A fixed set of episodes: so many of each task. ``rankable`` runs may enter a leaderboard."""

    name: str
    tasks: tuple[str, ...]
    episodes_per_task: int
    rankable: bool
    seed: int = OFFICIAL_SEED

    def episodes(self, *, exploration: bool) -> tuple[EpisodeSpec, ...]:
        """Return the episodes, task by task; with ``exploration`` those of that role too.

        Both roles face the same episodes. Playing has no exploration figure.
        """
        final = tuple(
            self._episode(Role.FINAL, task, index)
            for task in self.tasks
            for index in range(self.episodes_per_task)
        )
        if not exploration:
            return final
        return final + tuple(
            replace(spec, role=Role.EXPLORATION) for spec in final if spec.task in GOAL_TASKS
        )

    def _episode(self, role: Role, task: str, index: int) -> EpisodeSpec:
        seed = episode_seed(self.name, task, index, self.seed)
        names = object_names(task)
        drawn = np.random.default_rng(seed).integers(len(names)) if names else 0
        return EpisodeSpec(role, task, index, seed, names[drawn] if names else "")

    def differences(self, tasks: tuple[str, ...], episodes: int, seed: int) -> tuple[str, ...]:
        """Return what makes a run with these settings unofficial, in words."""
        found = []
        if not self.rankable:
            found.append(f"suite {self.name}")
        if tasks != self.tasks:
            found.append(f"tasks {', '.join(tasks)} only")
        if episodes != self.episodes_per_task:
            found.append(f"{episodes} of {self.episodes_per_task} episodes a task")
        if seed != OFFICIAL_SEED:
            found.append(f"seed {seed}")
        return tuple(found)


SUITES = {
    suite.name: suite
    for suite in (
        Suite("table4", TASK_NAMES, 100, rankable=True),
        Suite("smoke", TASK_NAMES, 5, rankable=False),
    )
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
