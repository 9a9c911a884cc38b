"""Runs of the same episodes compared, each against the first."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.records import Outcome, RunHeader, SavedRun
from minitouch_bench.regression.effects import Effect, holm, measure_effect
from minitouch_bench.regression.pairing import (
    EpisodePair,
    are_identical,
    collect_samples,
    pair_runs,
)
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.labels import run_labels, run_names, tasks_in_order

ALPHA = 0.05
"""Chance of a false difference, over all tasks and runs of one metric."""

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


@dataclass(frozen=True)
class Entrant:
    """A run in a comparison: the letter that stands for it, and where it lies."""

    letter: str
    name: str
    place: str
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """One metric of one task, judged.

    ``p_holm`` is adjusted over the tasks and runs of the metric. ``needed``: episodes that
    would resolve the difference if it is as observed, None for no difference or too many.
    ``detectable``: the smallest difference that the present episodes would show.
    """

    effect: Effect
    p_holm: float
    verdict: str
    needed: int | None
    detectable: float | None


@dataclass(frozen=True)
class Change:
    """An episode that ended in another way, and the commands that replay it."""

    key: str
    first: Outcome
    second: Outcome
    replays: tuple[str, str]


@dataclass(frozen=True)
class Versus:
    """One run against the first."""

    first: Entrant
    second: Entrant
    identical: bool
    findings: tuple[Finding, ...]
    changes: tuple[Change, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Comparison:
    """All runs against the first. ``tests`` counts the comparisons Holm's method is over."""

    entrants: tuple[Entrant, ...]
    pairs: tuple[Versus, ...]
    alpha: float = ALPHA


def compare_runs(runs: Sequence[SavedRun], places: Sequence[str]) -> Comparison:
    """Compare each run with the first; ``places`` are their directories, for replaying.

    Errors: UsageError for fewer than two runs or more than LETTERS, and for runs that were
    not made of the same episodes by the same protocol.
    """
    if not 2 <= len(runs) <= len(LETTERS):
        raise UsageError(f"compare takes 2 to {len(LETTERS)} runs, not {len(runs)}")
    entrants = [
        Entrant(letter, name, place, run_labels(run))
        for letter, name, place, run in zip(LETTERS, run_names(runs), places, runs, strict=False)
    ]
    paired = [pair_runs(runs[0], other) for other in runs[1:]]
    root = (runs[0].header.seed,)
    effects = [
        [measure_effect(sample, root) for sample in collect_samples(pairs, tasks_in_order(runs))]
        for pairs in paired
    ]
    adjusted = _adjust([effect for own in effects for effect in own])
    return Comparison(
        tuple(entrants),
        tuple(
            Versus(
                first=entrants[0],
                second=entrant,
                identical=are_identical(runs[0], run, pairs),
                findings=tuple(
                    _judge(effect, next(adjusted), (entrants[0].letter, entrant.letter))
                    for effect in own
                ),
                changes=find_changes(pairs, (entrants[0].place, entrant.place)),
                notes=differences_of_making(runs[0], run),
            )
            for entrant, run, pairs, own in zip(
                entrants[1:], runs[1:], paired, effects, strict=True
            )
        ),
    )


def find_changes(pairs: Sequence[EpisodePair], places: tuple[str, str]) -> tuple[Change, ...]:
    """Return the episodes whose outcome is another in the second run."""
    return tuple(
        Change(
            key=pair.key,
            first=pair.first.outcome,
            second=pair.second.outcome,
            replays=(replay_command(places[0], pair.key), replay_command(places[1], pair.key)),
        )
        for pair in pairs
        if pair.first.outcome is not pair.second.outcome
    )


def replay_command(place: str, key: str) -> str:
    """Return the command line that shows one episode of a run."""
    return shlex.join(["minitouch-bench", "replay", printable(place), key])


def differences_of_making(first: SavedRun, second: SavedRun) -> tuple[str, ...]:
    """Say in what two runs differ that is not the policy, and may matter."""
    machines = [run.environment.machine.get("processor", "unknown") for run in (first, second)]
    found = [*_packages(first, second), ("processor", machines[0], machines[1])]
    return differences_of_holding(first.header, second.header) + _in_words(found)


def differences_of_holding(first: RunHeader, second: RunHeader) -> tuple[str, ...]:
    """Say in what way two policies were held differently."""
    times = (f"{first.act_timeout_s:g}", f"{second.act_timeout_s:g}")
    return _in_words(
        [("isolation", first.isolation, second.isolation), ("seconds for an action", *times)]
    )


def _in_words(facts: Sequence[tuple[str, str, str]]) -> tuple[str, ...]:
    return tuple(
        printable(f"{what}: {one} in the first run, {other} in the second")
        for what, one, other in facts
        if one != other
    )


def _packages(first: SavedRun, second: SavedRun) -> Iterator[tuple[str, str, str]]:
    names = {**first.environment.packages, **second.environment.packages}
    for name in names:
        yield (
            name,
            first.environment.packages.get(name, "none"),
            second.environment.packages.get(name, "none"),
        )


def _adjust(effects: Sequence[Effect]) -> Iterator[float]:
    """Yield each effect's p-value, adjusted over all effects of its metric."""
    adjusted: dict[int, float] = {}
    for metric in METRICS:
        places = [place for place, effect in enumerate(effects) if effect.metric == metric]
        adjusted.update(zip(places, holm([effects[p].p_value for p in places]), strict=True))
    return (adjusted[place] for place in range(len(effects)))


def _judge(effect: Effect, p_holm: float, letters: tuple[str, str]) -> Finding:
    """Put an effect into words."""
    if effect.differing == 0:
        verdict = "equal in every episode"
    elif p_holm <= ALPHA:
        verdict = f"{letters[0] if effect.worsening > 0 else letters[1]} is better"
    else:
        verdict = "no difference seen"
    return Finding(
        effect=effect,
        p_holm=p_holm,
        verdict=verdict,
        needed=effect.resolution.episodes_to_detect(ALPHA),
        detectable=effect.resolution.detectable(ALPHA),
    )
