"""The regression gate: whether a candidate is worse than its baseline beyond a tolerance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from minitouch_bench.errors import UsageError
from minitouch_bench.records import SavedRun
from minitouch_bench.regression.comparison import (
    Change,
    differences_of_making,
    find_changes,
)
from minitouch_bench.regression.effects import Effect, holm, measure_effect
from minitouch_bench.regression.pairing import (
    EpisodePair,
    Sample,
    are_identical,
    collect_samples,
    pair_runs,
)
from minitouch_bench.regression.power import FEWEST_FOR_A_MEAN, MeanResolution
from minitouch_bench.regression.tolerances import GateSettings
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.labels import run_labels, tasks_in_order

FAILED = 1
"""Exit code of a regression, and with ``strict`` of an inconclusive gate."""


class Ruling(StrEnum):
    """What the gate says of a metric of a task, or of all."""

    REGRESSION = "regression"
    PASSED = "no regression"
    INCONCLUSIVE = "inconclusive"
    OPEN = "not decided"


@dataclass(frozen=True)
class Judgement:
    """One metric of one task.

    ``p_value`` is adjusted over all judgements of the gate; ``allowed`` is the tolerance in
    the metric's unit; ``needed``: episodes a task that would settle it, None for none or too
    many.
    """

    effect: Effect
    p_value: float
    allowed: float
    ruling: Ruling
    needed: int | None = None


@dataclass(frozen=True)
class Side:
    """One of the two runs: what it is called, where it lies, what must be known of it."""

    name: str
    place: str
    labels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Effort:
    """Episodes that a sequential gate has used, of those it had planned, and why it stopped.

    ``continuation``: the command that finishes an unfinished run, "" for a whole one.
    """

    used: int
    planned: int
    reason: str
    continuation: str = ""


@dataclass(frozen=True)
class Verdict:
    """What the gate found. ``effort`` is None where both runs were there already.

    ``identical``: every episode of both runs has the same bits.
    """

    baseline: Side
    candidate: Side
    ruling: Ruling
    settings: GateSettings
    identical: bool
    judgements: tuple[Judgement, ...]
    changes: tuple[Change, ...]
    notes: tuple[str, ...] = ()
    effort: Effort | None = None

    @property
    def exit_code(self) -> int:
        """0, or 1 for a regression; with ``strict`` 1 for whatever is not passed."""
        if self.ruling is Ruling.PASSED:
            return 0
        return FAILED if self.ruling is Ruling.REGRESSION or self.settings.strict else 0

    @property
    def needed(self) -> int | None:
        """The most episodes a task that an inconclusive judgement needs, None if unknown."""
        open_ones = [one for one in self.judgements if one.ruling is Ruling.INCONCLUSIVE]
        counts = [one.needed for one in open_ones if one.needed is not None]
        return max(counts) if counts and len(counts) == len(open_ones) else None


def judge_runs(
    baseline: SavedRun, candidate: SavedRun, places: tuple[str, str], settings: GateSettings
) -> Verdict:
    """Judge a candidate by its whole run, beside the baseline's.

    A metric is a regression where it is worse by more than its tolerance and, after Holm's
    method over everything judged, significantly different; it has passed where the 95 %
    interval excludes such a worsening; else it is inconclusive.

    Errors: UsageError where the runs cannot be paired, or have none of the metrics.
    """
    pairs = pair_runs(baseline, candidate)
    samples = guarded_samples(pairs, tasks_in_order((baseline,)), settings)
    effects = [measure_effect(sample, (baseline.header.seed,)) for sample in samples]
    judgements = judge_effects(effects, settings)
    identical = are_identical(baseline, candidate, pairs)
    if identical:
        judgements = tuple(replace(one, ruling=Ruling.PASSED, needed=None) for one in judgements)
    return Verdict(
        baseline=Side(printable(baseline.name), places[0], run_labels(baseline)),
        candidate=Side(printable(candidate.name), places[1], run_labels(candidate)),
        ruling=overall([one.ruling for one in judgements]),
        settings=settings,
        identical=identical,
        judgements=judgements,
        changes=find_changes(pairs, places),
        notes=differences_of_making(baseline, candidate),
    )


def guarded_samples(
    pairs: Sequence[EpisodePair], tasks: Sequence[str], settings: GateSettings
) -> tuple[Sample, ...]:
    """Return the samples of the metrics that the gate guards.

    Errors: UsageError if there is none.
    """
    found = tuple(
        sample for sample in collect_samples(pairs, tasks) if sample.metric in settings.metrics
    )
    if not found:
        raise UsageError(f"the runs have none of the metrics {', '.join(settings.metrics)}")
    return found


def judge_effects(effects: Sequence[Effect], settings: GateSettings) -> tuple[Judgement, ...]:
    """Judge effects together, at the level of the settings."""
    adjusted = holm([effect.p_value for effect in effects])
    level = settings.alpha / len(effects)
    found = []
    for effect, p_value in zip(effects, adjusted, strict=True):
        allowed = settings.tolerance(effect.task, effect.metric).absolute(effect.first)
        ruling, needed = Ruling.INCONCLUSIVE, None
        if effect.worsening > allowed and p_value <= settings.alpha:
            ruling = Ruling.REGRESSION
        elif effect.worst <= allowed and _has_enough(effect):
            ruling = Ruling.PASSED
        else:
            needed = _needed(effect, allowed, level)
        found.append(Judgement(effect, p_value, allowed, ruling, needed))
    return tuple(found)


def overall(rulings: Sequence[Ruling]) -> Ruling:
    """Return the ruling over all: one regression is enough, and all must have passed."""
    if Ruling.REGRESSION in rulings:
        return Ruling.REGRESSION
    return Ruling.PASSED if set(rulings) == {Ruling.PASSED} else Ruling.INCONCLUSIVE


def final_episodes(run: SavedRun) -> SavedRun:
    """Return a run without its exploration episodes, for a candidate that has none."""
    return replace(run, exploration_episodes=()) if run.exploration_episodes else run


def _has_enough(effect: Effect) -> bool:
    """Tell whether an interval may be believed; that of a share is good for any number."""
    return effect.count >= FEWEST_FOR_A_MEAN or not isinstance(effect.resolution, MeanResolution)


def _needed(effect: Effect, allowed: float, level: float) -> int | None:
    """Return the episodes that settle a metric: to show the worsening, or to exclude it."""
    if effect.worsening > allowed:
        found = effect.resolution.episodes_to_detect(level, beyond=allowed)
    else:
        found = effect.resolution.episodes_to_exclude(allowed)
    return None if found is None else max(found, effect.count + 1)
