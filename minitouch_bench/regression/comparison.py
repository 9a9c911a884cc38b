"""Runs of the same episodes compared, each against the first."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from minitouch_bench.errors import UsageError, printable
from minitouch_bench.files import ACTIONS_FILE
from minitouch_bench.metrics.metric import NO_DIRECTION
from minitouch_bench.metrics.significance import ALPHA, holm
from minitouch_bench.records import Outcome
from minitouch_bench.regression.paired_tests import Effect, paired_test
from minitouch_bench.regression.pairing import (
    COMPARED_METRICS,
    EpisodePair,
    PairedValues,
    are_identical,
    collect_values,
    pair_runs,
)
from minitouch_bench.regression.power import episodes_needed
from minitouch_bench.reporting.labels import run_labels, run_names, tasks_in_order
from minitouch_bench.runs.run import Run

if TYPE_CHECKING:
    import pandas as pd

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


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
class ComparedMetric:
    """One metric of one task in two runs, and what it shows.

    ``p_adjusted`` is over the tasks and runs of the metric. ``episodes_to_resolve`` would show
    the difference if it is as observed, None for no difference or too many.
    """

    effect: Effect
    p_adjusted: float
    verdict: str
    episodes_to_resolve: int | None


@dataclass(frozen=True)
class OutcomeChange:
    """An episode that ended in another way.

    ``replays``: the commands that replay it in each run, "" where the run has no actions.
    """

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


@dataclass(frozen=True, repr=False)
class Comparison:
    """All runs against the first; ``alpha``: chance of a false difference in a metric."""

    runs: tuple[ComparedRun, ...]
    pairs: tuple[RunPair, ...]
    alpha: float = ALPHA

    def to_frame(self) -> "pd.DataFrame":
        """Return a row per pair of runs (their letters), metric and task, as the tables have it."""
        import pandas as pd  # noqa: PLC0415  takes half a second

        return pd.DataFrame(
            {
                "first": pair.first, "second": pair.second,
                "task": effect.task, "metric": effect.metric, "unit": effect.unit,
                "first_value": effect.first, "second_value": effect.second,
                "difference": effect.difference.value,
                "low": effect.difference.low, "high": effect.difference.high,
                "count": effect.count, "p_value": effect.p_value,
                **{name: value for name, value in vars(compared).items() if name != "effect"},
            }
            for pair in self.pairs
            for compared in pair.metrics
            for effect in (compared.effect,)
        )  # fmt: skip

    def __repr__(self) -> str:
        names = ", ".join(f"{run.title} {run.name}" for run in self.runs)
        changed = sum(len(pair.changes) for pair in self.pairs)
        return f"<Comparison of {names}: {changed} changed outcomes>"

    def __str__(self) -> str:
        from minitouch_bench.regression.writers import comparison_text  # noqa: PLC0415  needs this

        return comparison_text(self)


def compare_runs(runs: Sequence[Run], paths: Sequence[str]) -> Comparison:
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
    tasks, root = tasks_in_order(runs), (runs[0].plan.seed,)
    tested = [
        [(values, paired_test(values, root)) for values in collect_values(pairs, tasks)]
        for pairs in paired
    ]
    adjusted = _adjusted([effect for row in tested for _, effect in row])
    first = named[0]
    return Comparison(
        tuple(named),
        tuple(
            RunPair(
                first=first.title,
                second=other.title,
                identical=are_identical(runs[0], run, pairs),
                metrics=tuple(
                    _compared(values, effect, next(adjusted), (first.title, other.title))
                    for values, effect in row
                ),
                changes=find_changes(pairs, (runs[0], run), (first.path, other.path)),
                notes=differences_of_making(runs[0], run),
            )
            for other, run, pairs, row in zip(named[1:], runs[1:], paired, tested, strict=True)
        ),
    )


def _in_shared_roles(first: Run, second: Run) -> tuple[Run, Run]:
    """Return two runs, without the exploration episodes that only one of them has."""
    if first.exploration_episodes and second.exploration_episodes:
        return first, second
    return replace(first, exploration_episodes=()), replace(second, exploration_episodes=())


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
            if other.exploration_episodes and not run.exploration_episodes
        ),
        *_in_words(facts),
    )


def _in_words(facts: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(
        printable(f"{what}: {here} in the first run, {there} in the second")
        for what, here, there in facts
        if here != there
    )


def _adjusted(effects: Sequence[Effect]) -> Iterator[float]:
    """Yield each effect's p-value, adjusted over all effects of its metric."""
    adjusted = {
        metric: iter(holm([effect.p_value for effect in effects if effect.metric == metric]))
        for metric in COMPARED_METRICS
    }
    return (next(adjusted[effect.metric]) for effect in effects)


def _compared(
    values: PairedValues, effect: Effect, p_adjusted: float, titles: tuple[str, str]
) -> ComparedMetric:
    return ComparedMetric(
        effect=effect,
        p_adjusted=p_adjusted,
        verdict=verdict(effect, p_adjusted, titles),
        episodes_to_resolve=episodes_needed(values, ALPHA),
    )


def verdict(effect: Effect, p_adjusted: float, titles: tuple[str, str]) -> str:
    """Put an effect into words: without a better direction the second run has more or less."""
    if effect.differing == 0:
        return "equal in every episode"
    if not effect.is_clear:
        return "no difference seen"
    if p_adjusted > ALPHA:
        return "not clear once adjusted"
    if effect.direction == NO_DIRECTION:
        return f"{titles[1]} has {'more' if effect.difference.value > 0 else 'less'}"
    return f"{titles[0] if effect.worsening > 0 else titles[1]} is better"
