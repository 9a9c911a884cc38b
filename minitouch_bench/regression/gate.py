"""The regression gate: whether a candidate is worse than its baseline beyond a tolerance."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from minitouch_bench.errors import UsageError
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.metrics.metric import NO_DIRECTION
from minitouch_bench.records import Outcome, RunHeader, SavedRun
from minitouch_bench.regression.comparison import (
    ComparedRun,
    OutcomeChange,
    differences_of_making,
    find_changes,
)
from minitouch_bench.regression.paired_tests import (
    Effect,
    holm,
    is_binary,
    measure_effect,
    resolution_of,
)
from minitouch_bench.regression.pairing import (
    MEAN_TASK,
    EpisodePair,
    PairedValues,
    are_identical,
    collect_values,
    pair_runs,
)
from minitouch_bench.regression.power import FEWEST_FOR_A_MEAN
from minitouch_bench.regression.settings import GateSettings
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.labels import policy_options, reproduce_command, tasks_in_order

FAILED = 1
"""Exit code of a regression, and with ``strict`` of an inconclusive gate."""


class Decision(StrEnum):
    """What the gate says of a metric of a task, or of all."""

    REGRESSION = "regression"
    PASSED = "no regression"
    INCONCLUSIVE = "inconclusive"
    OPEN = "not decided"


@dataclass(frozen=True)
class JudgedMetric:
    """One metric of one task.

    ``p_adjusted`` is over everything judged; ``tolerance`` is in the metric's unit;
    ``episodes_needed``: per task, to settle it, None for none or too many.
    """

    effect: Effect
    p_adjusted: float
    tolerance: float
    decision: Decision
    episodes_needed: int | None = None


@dataclass(frozen=True)
class EpisodesUsed:
    """Episodes that a sequential gate has used, of those it had planned, and why it stopped."""

    used: int
    planned: int
    reason: str


@dataclass(frozen=True)
class GateResult:
    """What the gate found, and the command to type next.

    ``identical``: every episode of both runs has the same bits. ``unjudged``: metrics
    without a better direction. ``left_out``: tasks whose rules have changed.
    ``episodes_used`` is None where both runs were there already; ``unfinished``: the
    candidate's run was stopped.
    """

    baseline: ComparedRun
    candidate: ComparedRun
    decision: Decision
    settings: GateSettings
    identical: bool
    judged: tuple[JudgedMetric, ...]
    unjudged: tuple[Effect, ...]
    changes: tuple[OutcomeChange, ...]
    notes: tuple[str, ...]
    next_command: str
    left_out: tuple[str, ...] = ()
    episodes_used: EpisodesUsed | None = None
    unfinished: bool = False

    @property
    def exit_code(self) -> int:
        """0, or 1 for a regression; with ``strict`` 1 for whatever is not passed."""
        if self.decision is Decision.PASSED:
            return 0
        return FAILED if self.decision is Decision.REGRESSION or self.settings.strict else 0

    @property
    def episodes_needed(self) -> int | None:
        """The most episodes per task that an inconclusive metric needs, None if unknown."""
        return episodes_needed(self.judged)


def judge_runs(
    baseline: SavedRun, candidate: SavedRun, paths: tuple[str, str], settings: GateSettings
) -> GateResult:
    """Judge a candidate by its whole run, beside the baseline's.

    A metric is a regression where it is worse by more than its tolerance and, after Holm's
    method over everything judged, significantly different; it has passed where the 95 %
    interval excludes such a worsening; else it is inconclusive.

    Raises:
        UsageError: the runs cannot be paired, or have none of the metrics.
    """
    pairs = pair_runs(baseline, candidate)
    guarded, others = guarded_values(pairs, tasks_in_order((baseline,)), settings)
    root = (baseline.header.seed,)
    judged = judge_values(guarded, settings, root)
    identical = are_identical(baseline, candidate, pairs)
    if identical:
        judged = tuple(
            replace(one, decision=Decision.PASSED, episodes_needed=None) for one in judged
        )
    changes = find_changes(pairs, paths)
    return GateResult(
        baseline=ComparedRun.of("baseline", baseline, paths[0]),
        candidate=ComparedRun.of("candidate", candidate, paths[1]),
        decision=overall([one.decision for one in judged]),
        settings=settings,
        identical=identical,
        judged=judged,
        unjudged=tuple(measure_effect(values, root) for values in others),
        changes=changes,
        notes=differences_of_making(baseline, candidate),
        next_command=_next_command(judged, changes, (baseline.header, candidate.header), paths),
        left_out=baseline.header.rules_differ(candidate.header),
    )


def guarded_values(
    pairs: Sequence[EpisodePair], tasks: Sequence[str], settings: GateSettings
) -> tuple[tuple[PairedValues, ...], tuple[PairedValues, ...]]:
    """Return the values of the metrics that the gate guards: with a direction, and without.

    Raises:
        UsageError: none has a direction.
    """
    found = [one for one in collect_values(pairs, tasks) if one.metric in settings.metrics]
    guarded = tuple(one for one in found if one.direction != NO_DIRECTION)
    if not guarded:
        names = ", ".join(settings.metrics)
        raise UsageError(f"nothing to judge: in {', '.join(tasks)} {names} cannot get worse")
    return guarded, tuple(one for one in found if one.direction == NO_DIRECTION)


def judge_values(
    guarded: Sequence[PairedValues], settings: GateSettings, root: tuple[int, ...]
) -> tuple[JudgedMetric, ...]:
    """Judge metrics together, at the level of the settings."""
    effects = [measure_effect(values, root) for values in guarded]
    adjusted = holm([effect.p_value for effect in effects])
    found = []
    for values, effect, p_value in zip(guarded, effects, adjusted, strict=True):
        allowed = settings.tolerance(effect.task, effect.metric).absolute(effect.first)
        # The interval of a share is good for any number of episodes.
        is_believed = effect.count >= FEWEST_FOR_A_MEAN or is_binary(effect.metric)
        decision, needed = Decision.INCONCLUSIVE, None
        if effect.worsening > allowed and p_value <= settings.alpha:
            decision = Decision.REGRESSION
        elif effect.worst <= allowed and is_believed:
            decision = Decision.PASSED
        else:
            needed = _needed(values, effect, allowed, settings.alpha / len(effects))
        found.append(JudgedMetric(effect, p_value, allowed, decision, needed))
    return tuple(found)


def overall(decisions: Sequence[Decision]) -> Decision:
    """Return the decision over all: one regression is enough, and all must have passed."""
    if Decision.REGRESSION in decisions:
        return Decision.REGRESSION
    return Decision.PASSED if set(decisions) == {Decision.PASSED} else Decision.INCONCLUSIVE


def episodes_needed(judged: Sequence[JudgedMetric]) -> int | None:
    """Return the most episodes per task that an inconclusive metric needs, None if unknown."""
    counts = [one.episodes_needed for one in judged if one.decision is Decision.INCONCLUSIVE]
    known = [count for count in counts if count is not None]
    return max(known) if known and len(known) == len(counts) else None


def _needed(values: PairedValues, effect: Effect, allowed: float, level: float) -> int | None:
    """Return the episodes per task that show the worsening, or exclude it.

    None where no number does, or more than a run can have.
    """
    resolution = resolution_of(values)
    if effect.worsening > allowed:
        found = resolution.episodes_to_detect(level, beyond=allowed)
    else:
        found = resolution.episodes_to_exclude(allowed)
    if found is None:
        return None
    per_task = -(-max(found, effect.count + 1) // len(values.tasks))
    return per_task if per_task <= MAX_EPISODES else None


def _next_command(
    judged: Sequence[JudgedMetric],
    changes: Sequence[OutcomeChange],
    headers: tuple[RunHeader, RunHeader],
    paths: tuple[str, str],
) -> str:
    """Return the command line that leads on from here.

    After a regression it replays an episode that was lost; where more episodes would settle
    the matter it plays them; else it compares the runs in full.
    """
    worse = {one.effect.task for one in judged if one.decision is Decision.REGRESSION}
    lost = [change for change in changes if change.first is Outcome.SUCCESS]
    for change in lost:
        if change.episode.split("/")[-2] in worse or worse == {MEAN_TASK}:
            return change.replays[1]
    if not worse and not headers[0].chosen and (needed := episodes_needed(judged)):
        return _longer_gate(headers, paths[0], needed)
    return shlex.join(["minitouch-bench", "compare", *map(printable, paths)])


def _longer_gate(headers: tuple[RunHeader, RunHeader], path: str, episodes: int) -> str:
    """Return the commands that make a longer baseline and hold the candidate to it."""
    baseline, candidate = headers
    output = printable(f"{path.rstrip('/')}-{episodes}")
    evaluate = reproduce_command(replace(baseline, official=False, episodes=episodes))
    regress = ["minitouch-bench", "regress", candidate.policy.source, "--baseline", output]
    regress += policy_options(candidate)
    return f"{evaluate} {shlex.join(['--output', output])} && {shlex.join(map(printable, regress))}"
