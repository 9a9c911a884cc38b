"""Two runs laid side by side, episode by episode; what cannot be paired is refused."""

import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Episode, EpisodeSpec, Outcome, Role
from minitouch_bench.errors import UsageError, printable
from minitouch_bench.files import ACTIONS_FILE
from minitouch_bench.metrics.definitions import METRICS, ShownIn, metrics_shown_in
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.reporting.labels import run_labels
from minitouch_bench.runs.run import Run, RunHeader

COMPARED_METRICS = metrics_shown_in(ShownIn.TABLE4)
"""What two runs are compared in."""

MEAN_TASK = "mean"
"""Stands in a task's place for the mean over the tasks with a goal."""

MEAN_METRIC = "success"
"""The metric that has such a mean."""

NAMED_EPISODES = 3
"""Episodes that a refusal names."""


@dataclass(frozen=True)
class EpisodePair:
    """One episode as two policies played it."""

    role: Role
    first: Episode
    second: Episode

    @property
    def key(self) -> str:
        """Name of the episode inside both runs, as ``pushing/17``."""
        return episode_key(self.role, self.first)


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
    def of(
        cls, pairs: Sequence[EpisodePair], task: str, metric: str, tasks: tuple[str, ...]
    ) -> "PairedValues":
        """Return the values of those pairs that are of these tasks and have one in both runs."""
        known = METRICS[metric]
        if len(tasks) > 1 and not known.statistic.is_additive:
            raise UsageError(f"{metric} has no mean over tasks: {', '.join(tasks)}")
        both = [
            (known.value(pair.first), known.value(pair.second))
            for pair in pairs
            if pair.first.task in tasks and pair.role is known.role
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


def episode_key(role: Role, episode: Episode) -> str:
    """Name an episode inside its run."""
    return EpisodeSpec(role, episode.task, episode.index, episode.seed).key


def pair_runs(first: Run, second: Run) -> tuple[EpisodePair, ...]:
    """Pair the episodes of two runs, in the first one's order, where tasks have the same rules.

    Raises:
        UsageError: suite or seed differ, no task is left, or the episodes are not the same ones;
            the text says which.
    """
    _refuse_other_runs(first, second)
    left_out = first.header.rules_differ(second.header)
    here, there = _by_key(first, left_out), _by_key(second, left_out)
    _refuse_missing(first.name, second.name, [key for key in here if key not in there])
    _refuse_missing(second.name, first.name, [key for key in there if key not in here])
    pairs = []
    for key, (role, episode) in here.items():
        pair = EpisodePair(role, episode, there[key][1])
        _refuse_other_episode(pair)
        pairs.append(pair)
    return tuple(pairs)


def _refuse_other_runs(first: Run, second: Run) -> None:
    """Refuse two runs of another suite or seed, or with other rules in every task."""
    headers = (first.header, second.header)
    differing = first.header.rules_differ(second.header)
    is_other = {*differing} == {*first.plan.tasks} & {*second.plan.tasks}
    for what, left, right in (
        ("protocols", *(_rules(header, differing if is_other else ()) for header in headers)),
        ("suites", *(header.plan.suite for header in headers)),
        ("seeds", *(str(header.plan.seed) for header in headers)),
    ):
        if left != right:
            raise UsageError(
                f"'{_short(first.name)}' and '{_short(second.name)}' cannot be compared: "
                f"their {what} differ ({_short(left)}; {_short(right)})"
            )


def _refuse_other_episode(pair: EpisodePair) -> None:
    """Refuse a pair whose seeds or shapes differ.

    Raises:
        UsageError: one differs; the text names the episode.
    """
    for what, left, right in (
        ("seed", str(pair.first.seed), str(pair.second.seed)),
        ("shape", pair.first.shape, pair.second.shape),
    ):
        if left != right:
            raise UsageError(
                f"the episodes {pair.key} are not the same one: "
                f"{what} '{_short(left)}' in one run, '{_short(right)}' in the other"
            )


def are_identical(first: Run, second: Run, pairs: Sequence[EpisodePair]) -> bool:
    """Tell whether every episode of two runs holds the same bits, by digests and by rows."""
    if first.digest != second.digest:
        return False
    return all(_bits_of(pair.first) == _bits_of(pair.second) for pair in pairs)


def collect_values(pairs: Sequence[EpisodePair], tasks: Sequence[str]) -> tuple[PairedValues, ...]:
    """Return the values of each task and metric that has episodes, task by task, then the mean.

    Where tasks have unequal numbers of episodes there is no mean: it would be one over episodes.
    """
    wanted: list[tuple[str, str, tuple[str, ...]]] = [
        (task, metric, (task,))
        for task in tasks
        for metric in COMPARED_METRICS
        if METRICS[metric].is_in(task)
    ]
    counts = count_pairs(pairs, [task for task in tasks if task in GOAL_TASKS], MEAN_METRIC)
    goals = tuple(task for task, count in counts.items() if count)
    if len(goals) > 1 and len({counts[task] for task in goals}) == 1:
        wanted.append((MEAN_TASK, MEAN_METRIC, goals))
    collected = (PairedValues.of(pairs, *names) for names in wanted)
    return tuple(values for values in collected if len(values.first))


def count_pairs(pairs: Sequence[EpisodePair], tasks: Sequence[str], metric: str) -> dict[str, int]:
    """Return how many pairs each task has, of the role whose episodes the metric counts."""
    role = METRICS[metric].role
    present = Counter(pair.first.task for pair in pairs if pair.role is role)
    return {task: present[task] for task in tasks}


def _bits_of(episode: Episode) -> tuple[object, ...]:
    values = (METRICS[metric].value(episode) for metric in COMPARED_METRICS)
    return episode.digest, episode.outcome, *values


def _by_key(run: Run, left_out: Sequence[str]) -> dict[str, tuple[Role, Episode]]:
    by_key: dict[str, tuple[Role, Episode]] = {}
    for role, episodes in run.by_role():
        for episode in episodes:
            key = episode_key(role, episode)
            if key in by_key:
                raise UsageError(f"'{_short(run.name)}' holds the episode {key} twice")
            if episode.task not in left_out:
                by_key[key] = (role, episode)
    if not by_key:
        raise UsageError(f"'{_short(run.name)}' holds no episodes")
    return by_key


def _refuse_missing(there: str, here: str, missing: Sequence[str]) -> None:
    if missing:
        listed = ", ".join(missing[:NAMED_EPISODES])
        more = ", …" if len(missing) > NAMED_EPISODES else ""
        raise UsageError(
            f"'{_short(there)}' and '{_short(here)}' are not of the same episodes: "
            f"{len(missing)} of the first are not in the second ({listed}{more})"
        )


def _rules(header: RunHeader, tasks: Sequence[str]) -> str:
    digests = (f"{task} {header.task_digests.get(task, 'none')[:12]}" for task in tasks)
    return f"{header.protocol}: {', '.join(digests)}" if tasks else ""


def _short(text: str) -> str:
    """Return a text of a run so that it can stand inside a sentence."""
    plain = printable(text)
    return plain if len(plain) <= 80 else f"{plain[:80]}…"


@dataclass(frozen=True)
class ComparedRun:
    """A run, its ``labels``, and its title: a letter, or "baseline" and "candidate"."""

    title: str
    name: str
    path: str
    labels: tuple[str, ...]

    @classmethod
    def of(cls, title: str, run: Run, path: str) -> "ComparedRun":
        """Return a finished run under a title."""
        return cls(title, printable(run.name), path, run_labels(run))


@dataclass(frozen=True)
class OutcomeChange:
    """An episode that ended in another way.

    ``replays``: the commands that replay it in each run, "" where the run has no actions.
    """

    episode: str
    first: Outcome
    second: Outcome
    replays: tuple[str, str]


def find_changes(
    pairs: Sequence[EpisodePair], runs: tuple[Run, Run], paths: tuple[str, str]
) -> tuple[OutcomeChange, ...]:
    """Return the episodes whose outcome is another in the second run."""
    return tuple(
        OutcomeChange(
            episode=pair.key,
            first=pair.first.outcome,
            second=pair.second.outcome,
            replays=(
                replay_command(runs[0], paths[0], pair.key),
                replay_command(runs[1], paths[1], pair.key),
            ),
        )
        for pair in pairs
        if pair.first.outcome is not pair.second.outcome
    )


def replay_command(run: Run, path: str, episode: str) -> str:
    """Return the command line that shows one episode of a run, "" where it cannot be replayed.

    A run that is kept in memory, or as ``run.json`` alone, has no actions. A path of unprintable
    characters is not printed as it is.
    """
    has_actions = run.directory is not None and (run.directory / ACTIONS_FILE).is_file()
    if not has_actions or printable(path) != path:
        return ""
    place = f"./{path}" if path.startswith("-") else path
    return shlex.join(["minitouch-bench", "replay", place, episode])


def differences_of_making(first: Run, second: Run) -> tuple[str, ...]:
    """Say in what two runs differ that is not the policy, and may matter."""
    left_out = first.header.rules_differ(second.header)
    packages = (first.environment.packages, second.environment.packages)
    machines = (run.environment.machine.get("processor", "unknown") for run in (first, second))
    times = (f"{run.plan.limits.act_timeout_s:g}" for run in (first, second))
    facts = [
        ("isolation", first.header.isolation, second.header.isolation),
        ("seconds for an action", *times),
        *(
            (name, *(versions.get(name, "none") for versions in packages))
            for name in {**packages[0], **packages[1]}
        ),
        ("processor", *machines),
    ]
    return (
        *(f"{task} is left out: its rules differ" for task in map(printable, left_out)),
        *(
            f"exploration is left out: '{printable(run.name)}' has none"
            for run, other in ((first, second), (second, first))
            if other.exploration_rows and not run.exploration_rows
        ),
        *_in_words(facts),
    )


def _in_words(facts: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(
        printable(f"{what}: {here} in the first run, {there} in the second")
        for what, here, there in facts
        if here != there
    )
