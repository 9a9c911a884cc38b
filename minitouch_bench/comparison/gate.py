"""The regression gate: whether a candidate is worse than its baseline beyond a tolerance.

One question decides, the endpoint: the mean of one metric over the tasks that have it, by default
success over the tasks with a goal. It is tested once, at the gate's whole level. Only where it is
a regression are the metrics of each task tested, to say where: a fixed sequence, which keeps the
level (W. Maurer, L. A. Hothorn and W. Lehmacher, "Multiple comparisons in drug clinical trials
and preclinical assays: a-priori ordered hypotheses", 1995).
"""

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from minitouch_bench.comparison import pairing
from minitouch_bench.comparison.pairing import (
    ComparedRun,
    Effect,
    OutcomeChange,
    PairedValues,
    Pairs,
)
from minitouch_bench.episode import Outcome, Role, role_of, task_of
from minitouch_bench.errors import CHECK_FAILED, IncompleteCheckError, UsageError
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.metrics.definitions import METRICS, NO_DIRECTION, ranking_metric
from minitouch_bench.metrics.intervals import Root
from minitouch_bench.metrics.statistics import ALPHA, FEWEST_FOR_A_MEAN, SHARE, holm
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.reporting.labels import run_labels, tasks_in_order
from minitouch_bench.runs.run import Run, RunHeader
from minitouch_bench.text import printable

SMALLEST_ALPHA, LARGEST_ALPHA = 0.001, 0.25
"""The levels that a gate can have. A test at a smaller level finds nothing: with a level of 1e-9
even 29 lost episodes of 29 are not a regression."""


GATE_SIDES = ("baseline", "candidate")


@dataclass(frozen=True)
class Tolerance:
    """How much worse a metric may get: an amount in its unit, or a part of the baseline's mean."""

    amount: float
    relative: bool = False

    @classmethod
    def parse(cls, given: float | str) -> "Tolerance":
        """Read "0.05", or "10%" of the baseline's mean.

        Raises:
            UsageError: it is neither.
        """
        text = str(given).strip()
        try:
            amount = float(text.removesuffix("%"))
        except ValueError:
            raise UsageError("the tolerance is one number, or a percentage like '10%'") from None
        return cls(amount / 100.0, relative=True) if text.endswith("%") else cls(amount)

    def absolute(self, baseline: float) -> float:
        """Return the tolerance in the metric's unit, for a mean of the baseline."""
        return self.amount * abs(baseline) if self.relative else self.amount

    def __str__(self) -> str:
        return f"{100 * self.amount:g}%" if self.relative else f"{self.amount:g}"


DEFAULT_TOLERANCES: Mapping[str, Tolerance] = {
    "success": Tolerance(0.05),
    "exploration": Tolerance(0.05),
    "episode_steps": Tolerance(0.10, relative=True),
}
"""By metric: 5 points of success, a tenth of the steps."""

OTHER_TOLERANCE = Tolerance(0.20, relative=True)
"""Of every other metric."""


@dataclass(frozen=True)
class GateSettings:
    """What the gate asks for.

    ``metric``: what the endpoint is the mean of; "" for success, or for the touch share where no
    task has a goal. ``tolerance``: None for the metric's default. Where there are not enough
    episodes, ``strict`` always fails and ``lenient`` never does.

    Raises:
        UsageError: a value has no meaning.
    """

    alpha: float = ALPHA
    metric: str = ""
    tolerance: Tolerance | None = None
    strict: bool = False
    lenient: bool = False

    def __post_init__(self) -> None:
        if not SMALLEST_ALPHA <= self.alpha <= LARGEST_ALPHA:
            raise UsageError(f"alpha is from {SMALLEST_ALPHA} to {LARGEST_ALPHA}, not {self.alpha}")
        if self.metric and self.metric not in pairing.COMPARED_METRICS:
            known = ", ".join(pairing.COMPARED_METRICS)
            raise UsageError(f"no metric '{printable(self.metric)}' to guard; there are {known}")
        if self.strict and self.lenient:
            raise UsageError("a gate is strict or lenient, not both")
        is_share = METRICS[self.metric or pairing.MEAN_METRIC].is_fraction
        if self.tolerance and not 0.0 <= self.tolerance.amount < (1.0 if is_share else math.inf):
            room = "from 0 to below 1" if is_share else "0 or more"
            raise UsageError(f"the tolerance is {room}, not {self.tolerance}")

    def tolerance_of(self, metric: str) -> Tolerance:
        """Return the tolerance of the endpoint's metric."""
        return self.tolerance or DEFAULT_TOLERANCES.get(metric, OTHER_TOLERANCE)


class Decision(StrEnum):
    """What the gate says."""

    REGRESSION = "regression"
    NO_REGRESSION = "no regression"
    NOT_ENOUGH = "not enough episodes"
    NOT_ENOUGH_SEEDS = "not enough training seeds"

    @property
    def is_open(self) -> bool:
        """Whether there is no answer."""
        return self in (Decision.NOT_ENOUGH, Decision.NOT_ENOUGH_SEEDS)


@dataclass(frozen=True)
class Endpoint:
    """What decides: the mean of one metric over its tasks.

    ``p_value``: one-sided, of a candidate that is no worse. ``tolerance`` is in the metric's unit.
    ``episodes_needed``: per task, to settle it, None for none or too many; ``seeds_needed``: the
    same of training seeds on each side.
    """

    effect: Effect
    tasks: tuple[str, ...]
    p_value: float
    tolerance: float
    decision: Decision
    episodes_needed: int | None = None
    seeds_needed: int | None = None

    @property
    def is_beyond(self) -> bool:
        """Whether the candidate is worse by more than the tolerance in the episodes seen."""
        return self.effect.worsening > self.tolerance


@dataclass(frozen=True)
class TaskMetric:
    """A metric of one task. ``p_adjusted`` is over all of them, None where none was tested."""

    effect: Effect
    p_adjusted: float | None
    is_worse: bool


@dataclass(frozen=True)
class TrainingValue:
    """The endpoint's value in the run of one training seed, of the baseline or the candidate."""

    side: str
    path: str
    value: float


@dataclass(frozen=True)
class GateResult:
    """What the gate found, and the command to type next.

    ``identical``: every episode of both runs has the same bits. ``wall_s``: seconds that the
    candidate's runs took. ``trainings``: of each run, where there are several on each side.
    """

    suite: str
    baseline: ComparedRun
    candidate: ComparedRun
    decision: Decision
    settings: GateSettings
    identical: bool
    endpoint: Endpoint
    per_task: tuple[TaskMetric, ...]
    changes: tuple[OutcomeChange, ...]
    notes: tuple[str, ...]
    next_command: str
    wall_s: float
    trainings: tuple[TrainingValue, ...] = ()

    @property
    def exit_code(self) -> int:
        """0, 1 for a regression, 5 where there is no answer and it fails."""
        if self.decision is Decision.REGRESSION:
            return CHECK_FAILED
        is_open = self.decision.is_open and not self.settings.lenient
        fails = is_open and (self.settings.strict or self.endpoint.is_beyond)
        return IncompleteCheckError.exit_code if fails else 0


def judge_runs(
    baseline: Run, candidate: Run, paths: tuple[str, str], settings: GateSettings
) -> GateResult:
    """Judge a candidate by its whole run, beside the baseline's.

    Raises:
        UsageError: the runs cannot be paired, or have none of the metric.
    """
    refuse_other_rules(baseline, candidate.header)
    notes = tuple(pairing.differences_of_making(baseline, candidate))
    baseline, candidate = pairing.share_roles((baseline, candidate))
    pairs = pairing.pair_runs(baseline, candidate)
    tasks, root = tasks_in_order((baseline,)), (baseline.plan.seed,)
    values = endpoint_values(pairs, tasks, settings)
    endpoint = judge_endpoint(values, settings, root)
    identical = baseline.digest == candidate.digest
    if identical:
        endpoint = replace(endpoint, decision=Decision.NO_REGRESSION, episodes_needed=None)
    effects = [pairing.paired_test(values, root) for values in task_values(pairs, tasks)]
    per_task = judge_tasks(effects, endpoint, settings.alpha)
    changes = pairing.find_changes(pairs, (baseline, candidate), paths)
    named = [
        ComparedRun(title, printable(run.header.policy.name), path, run_labels(run))
        for title, run, path in zip(GATE_SIDES, (baseline, candidate), paths, strict=True)
    ]
    return GateResult(
        suite=baseline.plan.suite,
        baseline=named[0],
        candidate=named[1],
        decision=endpoint.decision,
        settings=settings,
        identical=identical,
        endpoint=endpoint,
        per_task=per_task,
        changes=changes,
        notes=notes,
        next_command=_next_command(endpoint, changes, paths),
        wall_s=candidate.environment.wall_s,
    )


def refuse_other_rules(baseline: Run, candidate: RunHeader) -> None:
    """Refuse a candidate that was not played by the baseline's rules, in each of its tasks.

    Raises:
        UsageError: the line names the tasks whose rules differ, or what else does.
    """
    header, name = baseline.header, printable(baseline.place)
    again = "make the baseline again"
    if other := header.rules_differ(candidate):
        raise UsageError(
            f"the rules of {printable(', '.join(other))} are not those that '{name}' was played "
            f"by: {again}"
        )
    here, there = _conditions(candidate), _conditions(header)
    if here != there:
        raise UsageError(
            f"the candidate's conditions and those of '{name}' differ "
            f"({printable(here)}; {printable(there)}): {again}"
        )


def _conditions(header: RunHeader) -> str:
    return ", ".join(header.plan.changes_in_words()) or "standard"


def endpoint_values(pairs: Pairs, tasks: Sequence[str], settings: GateSettings) -> PairedValues:
    """Return the values that decide, of all tasks in which the metric can get worse.

    Raises:
        UsageError: there are none, or the tasks have unequal numbers of episodes.
    """
    goals = [task for task in tasks if task in GOAL_TASKS]
    name = settings.metric or ranking_metric((goals or list(tasks))[0])
    metric = METRICS[name]
    deciding = tuple(task for task in tasks if metric.is_in(task) and metric.direction_in(task))
    title = pairing.MEAN_TASK if len(deciding) > 1 else "".join(deciding)
    counts = pairing.count_pairs(pairs, deciding, name)
    if len({*counts.values()}) > 1:
        numbers = ", ".join(f"{printable(task)} {count}" for task, count in counts.items())
        raise UsageError(
            f"no mean over tasks with unequal numbers of episodes ({numbers}): make the baseline "
            "again with equally many episodes of each task"
        )
    values = PairedValues.of(pairs, title, name, deciding)
    if not len(values.first):
        why = f"in {', '.join(tasks)} {name} cannot get worse"
        if deciding and metric.role is Role.EXPLORATION:
            why = "exploration episodes are missing: POLICY plays none, so give two runs with them"
        raise UsageError(f"nothing to judge: {why}")
    return values


def judge_endpoint(values: PairedValues, settings: GateSettings, root: Root) -> Endpoint:
    """Judge the endpoint over whole runs.

    It is a regression where the candidate is worse by more than the tolerance and, at the gate's
    level, significantly worse. It is none where the 95 % interval excludes a worsening beyond the
    tolerance. Otherwise there are not enough episodes.
    """
    effect = pairing.paired_test(values, root)
    # The interval of a share is good for any number of episodes.
    is_share = METRICS[effect.metric].statistic is SHARE
    is_believed = is_share or effect.difference.count >= FEWEST_FOR_A_MEAN
    endpoint = decide(effect, values.tasks, settings, is_believed=is_believed)
    if endpoint.decision is not Decision.NOT_ENOUGH:
        return endpoint
    needed = _needed(values, effect, endpoint.tolerance, settings.alpha)
    return replace(endpoint, episodes_needed=needed)


def decide(
    effect: Effect, tasks: tuple[str, ...], settings: GateSettings, *, is_believed: bool
) -> Endpoint:
    """Decide by an effect, whose interval excludes a worsening where it ``is_believed``."""
    allowed = settings.tolerance_of(effect.metric).absolute(effect.first)
    endpoint = Endpoint(effect, tasks, effect.p_worse, allowed, Decision.NOT_ENOUGH)
    if endpoint.is_beyond and endpoint.p_value <= settings.alpha:
        return replace(endpoint, decision=Decision.REGRESSION)
    if effect.worst <= allowed and is_believed:
        return replace(endpoint, decision=Decision.NO_REGRESSION)
    return endpoint


def task_values(pairs: Pairs, tasks: Sequence[str]) -> list[PairedValues]:
    """Return the values of every metric of every task that can get worse."""
    return [
        values
        for values in pairing.collect_values(pairs, tasks)
        if values.task != pairing.MEAN_TASK and values.direction != NO_DIRECTION
    ]


def judge_tasks(
    effects: Sequence[Effect], endpoint: Endpoint, alpha: float
) -> tuple[TaskMetric, ...]:
    """Judge the effects of all tasks, which are tested after a regression only."""
    if endpoint.decision is not Decision.REGRESSION:
        return tuple(TaskMetric(effect, None, is_worse=False) for effect in effects)
    adjusted = holm([effect.p_worse for effect in effects])
    return tuple(
        TaskMetric(effect, p_value, p_value <= alpha)
        for effect, p_value in zip(effects, adjusted, strict=True)
    )


def _needed(values: PairedValues, effect: Effect, allowed: float, level: float) -> int | None:
    """Return the episodes per task that show the worsening, or exclude it; None for too many."""
    needed = pairing.episodes_needed(values, 2.0 * level, allowed)
    if needed is None:
        return None
    per_task = max(needed, effect.difference.count // len(values.tasks) + 1)
    return per_task if per_task <= MAX_EPISODES else None


def _next_command(
    endpoint: Endpoint, changes: Sequence[OutcomeChange], paths: tuple[str, str]
) -> str:
    """Return the command line that leads on from here.

    After a regression it replays an episode that was lost, if the candidate's actions are kept;
    otherwise it compares the runs in full.
    """
    role = METRICS[endpoint.effect.metric].role
    replays = [
        change.replay
        for change in changes
        if change.first is Outcome.SUCCESS
        and role_of(change.episode) is role
        and task_of(change.episode) in endpoint.tasks
    ]
    if endpoint.decision is Decision.REGRESSION and any(replays):
        return replays[0]
    return shlex.join(["minitouch-bench", "compare", *map(printable, paths)])
