"""Two runs laid side by side, episode by episode, and the paired test of each metric.

Every difference that ``compare`` and ``regress`` show is of ``paired_test``, and computed once.
"""

import math
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Episode, Outcome, episode_key, role_of
from minitouch_bench.errors import UsageError
from minitouch_bench.files import ACTIONS_FILE
from minitouch_bench.metrics.definitions import DOWN, METRICS, UP, ShownIn, metrics_shown_in
from minitouch_bench.metrics.intervals import Estimate, Root, stream
from minitouch_bench.metrics.statistics import ALPHA
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.runs.plan import first_of
from minitouch_bench.runs.run import NAMED, Run, run_digest
from minitouch_bench.text import plain_line, printable

COMPARED_METRICS = metrics_shown_in(ShownIn.TABLE4)
"""What two runs are compared in."""

MEAN_TASK = "mean"
"""Stands in a task's place for the mean over the tasks with a goal."""

MEAN_METRIC = "success"
"""The metric that has such a mean."""

WORSE_SIGNS = {UP: -1.0, DOWN: 1.0}
"""Sign of a change for the worse, by a metric's better direction."""

SIMULATOR = "pybullet"
"""How the names of the simulator's distributions begin; a run has one of them."""

Pairs = Mapping[str, tuple[Episode, Episode]]
"""Episodes as two policies played them, by their key inside both runs, as ``pushing/17``."""


def pair_runs(first: Run, second: Run) -> Pairs:
    """Pair the episodes of two runs, in the first one's order.

    Raises:
        UsageError: suite, seed or a task's rules differ, or the episodes are not the same ones; the
            text says which.
    """
    runs = (first, second)
    _refuse_other("suites", runs, [run.plan.suite for run in runs])
    present = {row.task for row in first.rows}
    other = [task for task in first.header.rules_differ(second.header) if task in present]
    _refuse_other("protocols", runs, [_rules(run, other) for run in runs])
    _refuse_other("objects", runs, [run.plan.objects or "the tasks' own" for run in runs])
    _refuse_other("seeds", runs, [run.plan.seed for run in runs])
    here, there = map(_by_key, runs)
    alone = (
        [key for key in one if key not in other] for one, other in ((here, there), (there, here))
    )
    one_sided = [
        f"only '{plain_line(run.place)}' has {first_of(keys, NAMED)}" if keys else ""
        for run, keys in zip(runs, alone, strict=True)
    ]
    _refuse_other("episodes", runs, one_sided)
    for key, one in here.items():
        scenes = [f"seed {episode.seed}, shape '{episode.shape}'" for episode in (one, there[key])]
        _refuse_other(f"episodes {key}", runs, scenes)
    return {key: (one, there[key]) for key, one in here.items()}


def _refuse_other(what: str, runs: tuple[Run, Run], values: Sequence[object]) -> None:
    if values[0] != values[1]:
        names = " and ".join(f"'{plain_line(run.place)}'" for run in runs)
        differing = "; ".join(plain_line(str(value), 200) for value in values if value != "")
        raise UsageError(f"{names} are not of the same episodes: their {what} differ ({differing})")


def _rules(run: Run, tasks: Sequence[str]) -> str:
    digests = (f"{task} {run.header.task_digests.get(task, 'none')[:12]}" for task in tasks)
    return f"{run.header.protocol}: {', '.join(digests)}" if tasks else ""


def _by_key(run: Run) -> dict[str, Episode]:
    rows = [
        (episode_key(role, episode.task, episode.index), episode)
        for role, episodes in run.by_role()
        for episode in episodes
    ]
    by_key = dict(rows)
    if not 0 < len(rows) == len(by_key):
        raise UsageError(f"'{plain_line(run.place)}' holds no episodes, or one of them twice")
    return by_key


def share_roles(runs: Sequence[Run]) -> tuple[Run, ...]:
    """Return the runs, without their exploration episodes unless all of them have some."""
    if all(run.exploration_rows for run in runs):
        return tuple(runs)
    return tuple(without_exploration(run) if run.exploration_rows else run for run in runs)


def without_exploration(run: Run) -> Run:
    """Return a run without its exploration policy, with the digest of what is left."""
    header = replace(run.header, exploration=None)
    return replace(run, digest=run_digest(header, run.rows), header=header, exploration_rows=())


# What differs


@dataclass(frozen=True)
class PairedValues:
    """The paired values of one metric, float64 (N,) each; those of a share are 0 and 1.

    ``task`` names the task, or is MEAN_TASK; ``tasks`` are those whose episodes these are. The
    tasks of a mean have equally many episodes.
    """

    task: str
    metric: str
    tasks: tuple[str, ...]
    first: NDArray[np.float64]
    second: NDArray[np.float64]

    @classmethod
    def of(cls, pairs: Pairs, task: str, metric: str, tasks: tuple[str, ...]) -> "PairedValues":
        """Return the values of those pairs that are of these tasks and have one in both runs."""
        known = METRICS[metric]
        both = [
            (known.value(first), known.value(second))
            for key, (first, second) in pairs.items()
            if first.task in tasks and role_of(key) is known.role
        ]
        table = np.array([values for values in both if None not in values], np.float64)
        return cls(task, metric, tasks, *table.reshape(-1, 2).T)

    @property
    def direction(self) -> str:
        """UP or DOWN where more or less is better, else NO_DIRECTION; a mean has its metric's."""
        return METRICS[self.metric].direction_in(self.task)

    @property
    def differences(self) -> NDArray[np.float64]:
        """Second minus first, float64 (N,)."""
        return self.second - self.first


def collect_values(pairs: Pairs, tasks: Sequence[str]) -> tuple[PairedValues, ...]:
    """Return the values of each task and metric that has episodes, task by task, then the mean.

    Where tasks have unequal numbers of episodes there is no mean: it would be one over episodes.
    """
    wanted: list[tuple[str, str, tuple[str, ...]]] = [
        (task, metric, (task,))
        for task in tasks
        for metric in COMPARED_METRICS
        if METRICS[metric].is_in(task)
    ]
    counts = count_pairs(pairs, tasks, MEAN_METRIC)
    goals = tuple(task for task in tasks if task in GOAL_TASKS and counts[task])
    if len(goals) > 1 and len({counts[task] for task in goals}) == 1:
        wanted.append((MEAN_TASK, MEAN_METRIC, goals))
    collected = (PairedValues.of(pairs, *names) for names in wanted)
    return tuple(values for values in collected if len(values.first))


def count_pairs(pairs: Pairs, tasks: Sequence[str], metric: str) -> dict[str, int]:
    """Return how many pairs each task has, of the role whose episodes the metric counts."""
    role = METRICS[metric].role
    present = Counter(one.task for key, (one, _) in pairs.items() if role_of(key) is role)
    return {task: present[task] for task in tasks}


@dataclass(frozen=True)
class Effect:
    """A metric in both runs over the same episodes, and second minus first.

    ``direction``: UP or DOWN where more or less is better in this task, else NO_DIRECTION.
    ``difference`` has a 95 % interval, which contains 0 where ``p_value`` > 0.05; both are of this
    metric and task alone. ``differing`` counts the episodes whose values are not equal.
    """

    task: str
    metric: str
    unit: str
    direction: str
    first: float
    second: float
    difference: Estimate
    p_value: float
    differing: int

    @property
    def is_clear(self) -> bool:
        """Whether the test shows a difference and its interval excludes 0."""
        excludes_0 = self.difference.low > 0.0 or self.difference.high < 0.0
        return self.p_value <= ALPHA and excludes_0

    @property
    def worsening(self) -> float:
        """How much worse the second run is, in the metric's unit; negative if it is better.

        Raises:
            KeyError: the metric has no direction.
        """
        return self.difference.value * WORSE_SIGNS[self.direction]

    @property
    def p_worse(self) -> float:
        """The p-value that the second run is no worse: half the two-sided one, by symmetry."""
        return self.p_value / 2.0 if self.worsening > 0.0 else 1.0

    @property
    def worst(self) -> float:
        """The worsening at the worse end of the interval."""
        ends = (self.difference.low, self.difference.high)
        return max(end * WORSE_SIGNS[self.direction] for end in ends)


def paired_test(values: PairedValues, root: Root) -> Effect:
    """Estimate the difference of paired values and test it against 0, as their statistic does.

    Each (task, metric) draws from its own stream under ``root``. An interval is widened to 0 where
    its test, exact for few episodes, does not exclude 0.
    """
    statistic = METRICS[values.metric].statistic
    rng = stream(root, values.task, values.metric, "paired")
    difference, p_value = statistic.paired_test(values.first, values.second, rng)
    if p_value > ALPHA:
        low, high = min(difference.low, 0.0), max(difference.high, 0.0)
        difference = replace(difference, low=low, high=high)
    return Effect(
        task=values.task,
        metric=values.metric,
        unit=METRICS[values.metric].unit_in(values.task),
        direction=values.direction,
        first=float(values.first.mean()),
        second=float(values.second.mean()),
        difference=difference,
        p_value=p_value,
        differing=int(np.count_nonzero(values.differences)),
    )


MOST_EPISODES = 1_000_000
"""No larger number of episodes is ever asked for."""


def episodes_needed(
    values: PairedValues, level: float, tolerance: float | None = None
) -> int | None:
    """Return about how many episodes of each task settle a difference in four of five cases.

    The difference is taken to be as seen.
    ``tolerance``: see ``Statistic``; None where any difference is to be shown.
    None is returned for no difference or too many episodes.
    """
    worse = values.differences * WORSE_SIGNS.get(values.direction, 1.0)
    if tolerance is None:
        worse, tolerance = worse * np.sign(worse.mean()), 0.0
    needed = METRICS[values.metric].statistic.episodes_needed(worse, level, tolerance)
    return math.ceil(needed / len(values.tasks)) if needed <= MOST_EPISODES else None


# What is said of two runs


@dataclass(frozen=True)
class ComparedRun:
    """A run as a comparison names it: apart from ``Run``, because it is written to JSON.

    ``title``: a letter, or "baseline" and "candidate".
    """

    title: str
    name: str
    path: str
    labels: tuple[str, ...]


@dataclass(frozen=True)
class OutcomeChange:
    """An episode that ended in another way.

    ``replay``: see ``replay_command``.
    """

    episode: str
    first: Outcome
    second: Outcome
    replay: str


def find_changes(
    pairs: Pairs, runs: tuple[Run, Run], paths: tuple[str, str]
) -> tuple[OutcomeChange, ...]:
    """Return the episodes whose outcome is another in the second run."""
    return tuple(
        OutcomeChange(key, first.outcome, second.outcome, replay_command(runs, paths, key))
        for key, (first, second) in pairs.items()
        if first.outcome is not second.outcome
    )


def replay_command(runs: tuple[Run, Run], paths: tuple[str, str], episode: str) -> str:
    """Return the command line that shows one episode of the second run, beside the first's.

    It is "" where the second cannot be replayed: a run that is kept in memory, or as ``run.json``
    alone, has no actions. A path of unprintable characters is not printed as it is.
    """
    first, second = map(_replayable, runs, paths)
    words = ["minitouch-bench", "replay", first or second, episode]
    return shlex.join([*words, *(["--beside", second] if first else [])]) if second else ""


def _replayable(run: Run, path: str) -> str:
    """Return a run's path as a command takes it, "" where it has no actions."""
    has_actions = run.directory is not None and (run.directory / ACTIONS_FILE).is_file()
    if not has_actions or printable(path) != path:
        return ""
    return f"./{path}" if path.startswith("-") else path


def differences_of_making(first: Run, second: Run) -> Iterator[str]:
    """Say in what two runs differ that is not the policy, and may matter."""
    for task in first.header.rules_differ(second.header):
        yield f"{printable(task)} is left out: its rules differ"
    for one_run, other_run in ((first, second), (second, first)):
        if alone := [task for task in one_run.tasks if task not in other_run.tasks]:
            yield printable(f"left out, because '{other_run.place}' has none: {', '.join(alone)}")
    yield from exploration_left_out((first, second))
    here, there = _making(first), _making(second)
    for what in {**here, **there}:
        one, other = here.get(what, "none"), there.get(what, "none")
        if one != other:
            yield printable(f"{what}: {one} in the first run, {other} in the second")


def exploration_left_out(runs: Sequence[Run]) -> Iterator[str]:
    """Say which runs have no exploration episodes where others have."""
    lacking = [f"'{printable(run.place)}'" for run in runs if not run.exploration_rows]
    if 0 < len(lacking) < len(runs):
        has = "has" if len(lacking) == 1 else "have"
        yield f"exploration is left out: {first_of(lacking, NAMED)} {has} none"


def _making(run: Run) -> dict[str, str]:
    packages = {**run.environment.packages}
    builds = [name for name in packages if name.startswith(SIMULATOR)]
    return {
        "isolation": run.header.isolation,
        "seconds for an action": f"{run.plan.limits.act_timeout_s:g}",
        "simulator": ", ".join(f"{name} {packages.pop(name)}" for name in builds),
        **packages,
        "processor": run.environment.machine.get("processor", "unknown"),
    }
