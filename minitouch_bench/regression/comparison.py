"""Runs of the same episodes compared, each against the first."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.metric import NO_DIRECTION
from minitouch_bench.records import Outcome, RunHeader, SavedRun
from minitouch_bench.regression.differences import ALPHA
from minitouch_bench.regression.paired_tests import Effect, holm, measure_effect, resolution_of
from minitouch_bench.regression.pairing import (
    COMPARED_METRICS,
    EpisodePair,
    are_identical,
    collect_values,
    pair_runs,
)
from minitouch_bench.regression.power import Resolution
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.labels import run_labels, run_names, tasks_in_order

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


@dataclass(frozen=True)
class ComparedRun:
    """A run and what stands for it: a letter, or "baseline" and "candidate".

    ``labels``: what a reader must know of it.
    """

    title: str
    name: str
    path: str
    labels: tuple[str, ...] = ()

    @classmethod
    def of(cls, title: str, run: SavedRun, path: str) -> "ComparedRun":
        """Return a finished run under a title."""
        return cls(title, printable(run.name), path, run_labels(run))


@dataclass(frozen=True)
class ComparedMetric:
    """One metric of one task in two runs, and what it shows.

    ``p_adjusted`` is over the tasks and runs of the metric. ``episodes_to_resolve`` would show
    the difference if it is as observed, None for no difference or too many. ``detectable``: the
    smallest difference that the present episodes show.
    """

    effect: Effect
    p_adjusted: float
    verdict: str
    episodes_to_resolve: int | None
    detectable: float | None


@dataclass(frozen=True)
class OutcomeChange:
    """An episode that ended in another way, and the commands that replay it."""

    episode: str
    first: Outcome
    second: Outcome
    replays: tuple[str, str]


@dataclass(frozen=True)
class RunPair:
    """One run against the first, by their titles. ``notes``: what else is not alike."""

    first: str
    second: str
    identical: bool
    metrics: tuple[ComparedMetric, ...]
    changes: tuple[OutcomeChange, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Comparison:
    """All runs against the first.

    ``alpha``: chance of a false difference, over all tasks and runs of one metric.
    """

    runs: tuple[ComparedRun, ...]
    pairs: tuple[RunPair, ...]
    alpha: float = ALPHA


def compare_runs(runs: Sequence[SavedRun], paths: Sequence[str]) -> Comparison:
    """Compare each run with the first; ``paths`` are their directories, for replaying.

    Raises:
        UsageError: fewer than two runs or more than LETTERS, or runs that were not made of the
            same episodes by the same protocol.
    """
    if not 2 <= len(runs) <= len(LETTERS):
        raise UsageError(f"compare takes 2 to {len(LETTERS)} runs, not {len(runs)}")
    named = [
        ComparedRun(letter, name, path, run_labels(run))
        for letter, name, path, run in zip(LETTERS, run_names(runs), paths, runs, strict=False)
    ]
    paired = [pair_runs(*_in_shared_roles(runs[0], other)) for other in runs[1:]]
    root = (runs[0].header.seed,)
    values = [collect_values(pairs, tasks_in_order(runs)) for pairs in paired]
    effects = [[measure_effect(one, root) for one in own] for own in values]
    adjusted = _adjusted([effect for own in effects for effect in own])
    return Comparison(
        tuple(named),
        tuple(
            RunPair(
                first=named[0].title,
                second=other.title,
                identical=are_identical(runs[0], run, pairs),
                metrics=tuple(
                    _compared(
                        effect, resolution_of(one), next(adjusted), (named[0].title, other.title)
                    )
                    for effect, one in zip(effects[index], values[index], strict=True)
                ),
                changes=find_changes(pairs, (named[0].path, other.path)),
                notes=differences_of_making(runs[0], run),
            )
            for index, (other, run, pairs) in enumerate(
                zip(named[1:], runs[1:], paired, strict=True)
            )
        ),
    )


def _in_shared_roles(first: SavedRun, second: SavedRun) -> tuple[SavedRun, SavedRun]:
    """Return two runs, without the exploration episodes that only one of them has."""
    if first.exploration_episodes and second.exploration_episodes:
        return first, second
    return replace(first, exploration_episodes=()), replace(second, exploration_episodes=())


def find_changes(pairs: Sequence[EpisodePair], paths: tuple[str, str]) -> tuple[OutcomeChange, ...]:
    """Return the episodes whose outcome is another in the second run."""
    return tuple(
        OutcomeChange(
            episode=pair.key,
            first=pair.first.outcome,
            second=pair.second.outcome,
            replays=(replay_command(paths[0], pair.key), replay_command(paths[1], pair.key)),
        )
        for pair in pairs
        if pair.first.outcome is not pair.second.outcome
    )


def replay_command(path: str, episode: str) -> str:
    """Return the command line that shows one episode of a run."""
    return shlex.join(["minitouch-bench", "replay", printable(path), episode])


def differences_of_making(first: SavedRun, second: SavedRun) -> tuple[str, ...]:
    """Say in what two runs differ that is not the policy, and may matter."""
    left_out = first.header.rules_differ(second.header)
    packages = (first.environment.packages, second.environment.packages)
    machines = (run.environment.machine.get("processor", "unknown") for run in (first, second))
    found = [
        *(
            (name, *(own.get(name, "none") for own in packages))
            for name in {**packages[0], **packages[1]}
        ),
        ("processor", *machines),
    ]
    return (
        *(f"{task} is left out: its rules differ" for task in map(printable, left_out)),
        *(
            f"exploration is left out: '{printable(run.name)}' has none"
            for run, other in ((first, second), (second, first))
            if other.exploration_episodes and not run.exploration_episodes
        ),
        *differences_of_isolation(first.header, second.header),
        *_in_words(found),
    )


def differences_of_isolation(first: RunHeader, second: RunHeader) -> tuple[str, ...]:
    """Say in what way two policies were run differently."""
    times = (f"{first.act_timeout_s:g}", f"{second.act_timeout_s:g}")
    return _in_words(
        [("isolation", first.isolation, second.isolation), ("seconds for an action", *times)]
    )


def _in_words(facts: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(
        printable(f"{what}: {one} in the first run, {other} in the second")
        for what, one, other in facts
        if one != other
    )


def _adjusted(effects: Sequence[Effect]) -> Iterator[float]:
    """Yield each effect's p-value, adjusted over all effects of its metric."""
    found = [0.0] * len(effects)
    for metric in COMPARED_METRICS:
        own = [index for index, effect in enumerate(effects) if effect.metric == metric]
        for index, p_value in zip(own, holm([effects[i].p_value for i in own]), strict=True):
            found[index] = p_value
    return iter(found)


def _compared(
    effect: Effect, resolution: Resolution, p_adjusted: float, titles: tuple[str, str]
) -> ComparedMetric:
    return ComparedMetric(
        effect=effect,
        p_adjusted=p_adjusted,
        verdict=verdict(effect, p_adjusted, titles),
        episodes_to_resolve=resolution.episodes_to_detect(ALPHA),
        detectable=resolution.detectable(ALPHA),
    )


def verdict(effect: Effect, p_adjusted: float, titles: tuple[str, str]) -> str:
    """Put an effect into words: without a better direction the second run has more or less."""
    if effect.differing == 0:
        return "equal in every episode"
    if effect.p_value > ALPHA:
        return "no difference seen"
    if p_adjusted > ALPHA:
        return "not clear once adjusted"
    if effect.direction == NO_DIRECTION:
        return f"{titles[1]} has {'more' if effect.difference.value > 0 else 'less'}"
    return f"{titles[0] if effect.worsening > 0 else titles[1]} is better"
