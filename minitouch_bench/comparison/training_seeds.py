"""Methods judged by a run of each of their training seeds: the seed is the unit.

``regress`` asks one-sided whether the candidate got worse: a gate on one checkpoint cannot
distinguish a worse method from an unlucky training seed. ``compare`` asks two-sided which of two
methods is better, by the same differences and intervals.
"""

import math
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import scipy

from minitouch_bench.comparison import comparison, gate, pairing
from minitouch_bench.comparison.gate import GATE_SIDES, TrainingValue
from minitouch_bench.comparison.pairing import MEAN_TASK, ComparedRun, Effect, PairedValues
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics import intervals
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.statistics import (
    ALPHA,
    ALPHA_IN_WORDS,
    FEWEST_FOR_A_MEAN,
    MAX_SEEDS,
    POWER,
    SHARE,
    seeds_to_decide,
)
from minitouch_bench.reporting import tables
from minitouch_bench.reporting.labels import format_value, run_labels, task_title, tasks_in_order
from minitouch_bench.runs.run import Run
from minitouch_bench.text import printable

SIDES = ("A", "B")

OVER_TRAININGS = "Student's t over training seeds, of shares no narrower than over all episodes"

METHODS_VERSION = 2
"""Of the JSON document."""

Sides = Sequence[Sequence[Run]]
"""Two of them: the runs of the training seeds of each side."""

SideValues = Sequence[Sequence[PairedValues]]
"""By side and run a metric of a task, in which the run itself is the second of each pair."""


def pair_trainings(sides: Sides, titles: Sequence[str]) -> tuple[list[pairing.Pairs], ...]:
    """Pair each run of both sides with the first run of the first side, side by side.

    Raises:
        UsageError: one training is given twice, or the runs are not of the same episodes.
    """
    for title, side in zip(titles, sides, strict=True):
        known = [[run.header.policy.digest or run.digest, run.digest] for run in side]
        if any(len({*digests}) < len(side) for digests in zip(*known, strict=True)):
            raise UsageError(f"two runs of the {title} are of one training: give each one once")
    runs = pairing.share_roles([*sides[0], *sides[1]])
    pairs = [pairing.pair_runs(runs[0], run) for run in runs]
    return pairs[: len(sides[0])], pairs[len(sides[0]) :]


def _by_metric(
    paired: Sequence[Sequence[pairing.Pairs]],
    collect: Callable[[pairing.Pairs], Sequence[PairedValues]],
) -> list[SideValues]:
    """Return each metric of each task that is collected from the pairs of every run."""
    sides = [zip(*map(collect, side), strict=True) for side in paired]
    return [*zip(*sides, strict=True)]


def _side_of(title: str, side: Sequence[Run], paths: Sequence[str]) -> ComparedRun:
    """Name the runs of one side together."""
    labels = tuple(dict.fromkeys(label for run in side for label in run_labels(run)))
    return ComparedRun(title, f"{len(side)} trainings", ", ".join(paths), labels)


def _values_of_trainings(
    titles: Sequence[str], sides: SideValues, paths: Sequence[Sequence[str]]
) -> tuple[TrainingValue, ...]:
    return tuple(
        TrainingValue(title, path, float(values.second.mean()))
        for title, side, places in zip(titles, sides, paths, strict=True)
        for values, path in zip(side, places, strict=True)
    )


# The test


def training_differences(sides: SideValues) -> intervals.MeanDifferences:
    """Compare the means of both sides, the second side's first: see ``mean_differences``."""
    return intervals.mean_differences(
        [[np.array([values.second for values in side]) for side in sides[::-1]]]
    )


def compare_trainings(sides: SideValues) -> Effect:
    """Estimate the difference of the second side's mean and the first's, and test it against 0.

    The unit is the training seed: see ``mean_differences``.
    """
    like = sides[0][0]
    metric = METRICS[like.metric]
    before, after = (np.array([values.second for values in side]) for side in sides)
    found = training_differences(sides)
    value, variance, freedom = (
        float(table[0, 1]) for table in (found.value, found.variance, found.freedom)
    )
    reach = float(scipy.stats.t.ppf(intervals.INTERVAL_ENDS[1], freedom)) * math.sqrt(variance)
    low, high = value - reach, value + reach
    if metric.statistic is SHARE:
        shares = (intervals.wilson(round(won.sum()), won.size) for won in (after, before))
        over_episodes = intervals.newcombe(*shares)
        low, high = min(low, over_episodes.low), max(high, over_episodes.high)
    least, most = metric.range_in(like.tasks[0], difference=True)
    seeds = len(before) + len(after)
    return Effect(
        task=like.task,
        metric=like.metric,
        unit=metric.unit_in(like.task),
        direction=like.direction,
        first=float(before.mean()),
        second=float(after.mean()),
        difference=intervals.Estimate(
            value, max(low, least), min(high, most), seeds, OVER_TRAININGS
        ),
        p_value=float(found.p_values[0, 1]),
        differing=int(np.count_nonzero(before.mean(axis=0) != after.mean(axis=0))),
    )


def _seeds_needed(sides: SideValues, level: float, difference: float | None = None) -> int | None:
    """Return about how many seeds of each side would decide: see ``seeds_to_decide``."""
    seeds = len(sides[1]), len(sides[0])
    return seeds_to_decide(training_differences(sides), seeds, level, difference)


# The gate


def judge(
    sides: Sides, paths: Sequence[Sequence[str]], settings: gate.GateSettings
) -> gate.GateResult:
    """Judge a candidate's run beside the baseline's, or the runs of a method's training seeds.

    Raises:
        UsageError: see ``gate.judge_runs`` and ``judge_trainings``.
    """
    (baseline, *more), (candidate, *others) = sides
    if more or others:
        return judge_trainings(sides, paths, settings)
    return gate.judge_runs(baseline, candidate, (paths[0][0], paths[1][0]), settings)


def judge_trainings(
    sides: Sides, paths: Sequence[Sequence[str]], settings: gate.GateSettings
) -> gate.GateResult:
    """Judge a method by the runs of its training seeds, beside those of the baseline.

    Raises:
        UsageError: a side has one run, or one training twice; there are too few episodes; the runs
            are not of the same episodes, or have none of the metric.
    """
    runs = [*sides[0], *sides[1]]
    for title, side in zip(GATE_SIDES, sides, strict=True):
        if len(side) < 2:
            raise UsageError(
                f"the {title} has one run: give one run on each side, or on both two or more, one "
                "of each training seed"
            )
    for run in runs:
        gate.refuse_other_rules(runs[0], run.header)
    tasks = tasks_in_order(runs[:1])
    paired = pair_trainings(sides, GATE_SIDES)
    deciding = [[gate.endpoint_values(pairs, tasks, settings) for pairs in side] for side in paired]
    if (episodes := len(deciding[0][0].first)) < FEWEST_FOR_A_MEAN:
        raise UsageError(
            f"a gate over training seeds needs {FEWEST_FOR_A_MEAN} episodes, not {episodes}: "
            "evaluate all runs again with more"
        )
    effect = compare_trainings(deciding)
    endpoint = gate.decide(effect, deciding[0][0].tasks, settings, is_believed=True)
    if endpoint.decision.is_open:
        endpoint = replace(
            endpoint,
            decision=gate.Decision.NOT_ENOUGH_SEEDS,
            seeds_needed=_seeds_to_settle(deciding, endpoint, settings.alpha),
        )
    by_metric = _by_metric(paired, lambda pairs: gate.task_values(pairs, tasks))
    effects = [compare_trainings(both) for both in by_metric]
    baseline, candidate = map(_side_of, GATE_SIDES, sides, paths)
    shown = (printable(path) for places in paths for path in places)
    return gate.GateResult(
        suite=runs[0].plan.suite,
        baseline=baseline,
        candidate=candidate,
        decision=endpoint.decision,
        settings=settings,
        identical=False,
        endpoint=endpoint,
        per_task=gate.judge_tasks(effects, endpoint, settings.alpha),
        changes=(),
        notes=tuple(pairing.exploration_left_out(runs)),
        next_command=shlex.join(["minitouch-bench", "report", *shown]),
        wall_s=sum(run.environment.wall_s for run in sides[1]),
        trainings=_values_of_trainings(GATE_SIDES, deciding, paths),
    )


def _seeds_to_settle(sides: SideValues, endpoint: gate.Endpoint, alpha: float) -> int | None:
    """Return about how many seeds of each side show the worsening, or exclude it as observed."""
    distance = abs(endpoint.effect.worsening - endpoint.tolerance)
    if endpoint.is_beyond:  # significant, and beyond the tolerance in four of five cases too
        needed = [_seeds_needed(sides, 2.0 * alpha), _seeds_needed(sides, 1.0, distance)]
    else:
        needed = [_seeds_needed(sides, ALPHA, distance)]
    if None in needed:
        return None
    return max(min(map(len, sides)) + 1, *filter(None, needed))


# The comparison


METHOD_NOTES = (
    "Brackets and p: of this row alone, two-sided; 95 % interval and Student's t over training "
    "seeds, on the same episodes. p adjusted and verdict: over all rows of the metric by "
    f"Holm's method, judged at {ALPHA_IN_WORDS}. Where some seeds fail to learn, no test over "
    "a few seeds keeps its level: look at each seed's value.",
    "Seeds to decide: about how many training seeds of each method, those present included, "
    f"find the difference in {100 * POWER:g} % of such studies if it and the seeds' spread are as "
    f"observed. A dash: shown already, or more than {MAX_SEEDS:,}, where only more episodes help.",
)
"""How the figures of a comparison of methods were made."""


@dataclass(frozen=True, repr=False)
class MethodComparison(comparison.WrittenComparison):
    """Two methods, each by its trainings; ``main`` is what sums them up, one of ``metrics``."""

    heading = "Comparison of methods"
    mark = MappingProxyType({"format": "minitouch-methods", "version": METHODS_VERSION})

    methods: tuple[ComparedRun, ComparedRun]
    trainings: tuple[TrainingValue, ...]
    main: comparison.MetricVerdict
    metrics: tuple[comparison.MetricVerdict, ...]
    notes: tuple[str, ...]
    alpha: float = ALPHA

    def __repr__(self) -> str:
        return f"<MethodComparison: {answer_line(self)}>"

    def _blocks(self, changes: int) -> Iterator[tables.Block]:
        yield from map(comparison.run_line, self.methods)
        yield from (f"{note}." for note in self.notes)
        yield ""
        yield trainings_table(self.trainings, self.main.effect)
        yield from comparison.verdict_tables(SIDES, self.metrics, "Seeds to decide")
        yield ""
        yield from map(tables.NoteBlock, METHOD_NOTES)
        yield from ("", answer_line(self))


def compare_method_runs(sides: Sides, paths: Sequence[Sequence[str]]) -> MethodComparison:
    """Compare two methods by the runs of their training seeds; ``paths``: their directories.

    Raises:
        UsageError: a method has one run, one training twice or runs under several conditions; the
            runs have too few episodes, or not the same ones.
    """
    for title, side in zip(SIDES, sides, strict=True):
        if len(side) < 2:
            raise UsageError(
                f"a method is compared by two training seeds or more, and --{title.lower()} names "
                f"{len(side)}: for two runs give their directories alone"
            )
        if len({run.plan.conditions for run in side}) > 1:
            raise UsageError(f"the runs of {title} are not of one method: their conditions differ")
    runs = [*sides[0], *sides[1]]
    kept = comparison.shared_tasks(runs)
    tasks = tasks_in_order(kept[:1])
    paired = pair_trainings((kept[: len(sides[0])], kept[len(sides[0]) :]), SIDES)
    collected = _by_metric(paired, lambda pairs: pairing.collect_values(pairs, tasks))
    if (episodes := min(len(values[0][0].first) for values in collected)) < FEWEST_FOR_A_MEAN:
        raise UsageError(
            f"methods are compared by {FEWEST_FOR_A_MEAN} episodes of each task or more, not by "
            f"{episodes}: evaluate all runs again with more"
        )
    metrics = _judge_metrics(collected)
    main = next(
        (one for one in metrics if one.effect.task == MEAN_TASK),
        next(one for one in metrics if one.effect.metric == ranking_metric(one.effect.task)),
    )
    trainings = _values_of_trainings(SIDES, collected[metrics.index(main)], paths)
    first, second = map(_side_of, SIDES, sides, paths)
    compared = {one.effect.task for one in metrics}
    left_out = sorted({task for run in runs for task in run.tasks} - compared)
    lacking = [
        f"left out, because not every run has it by these rules: {task}" for task in left_out
    ]
    notes = (*map(printable, lacking), *pairing.exploration_left_out(runs))
    return MethodComparison((first, second), trainings, main, metrics, notes)


def _judge_metrics(collected: Sequence[SideValues]) -> tuple[comparison.MetricVerdict, ...]:
    """Return what each metric of each task shows, adjusted over the rows of its metric."""
    effects = [compare_trainings(sides) for sides in collected]
    adjusted = comparison.adjust(effects)
    undecided = Counter(
        effect.metric for effect, p in zip(effects, adjusted, strict=True) if p > ALPHA
    )
    metrics = []
    for sides, effect, p_adjusted in zip(collected, effects, adjusted, strict=True):
        verdict = comparison.effect_in_words(effect, p_adjusted, SIDES)
        needed = None
        if p_adjusted > ALPHA:
            needed = _seeds_needed(sides, ALPHA / undecided[effect.metric])
        metrics.append(comparison.MetricVerdict(effect, p_adjusted, verdict, needed))
    return tuple(metrics)


# What is written


def seeds_in_words(number: int | None, trainings: Sequence[TrainingValue]) -> str:
    """Say how many training seeds of each side there should be, and how many more that is."""
    if number is None:
        return f"more than {MAX_SEEDS:,} training seeds on each side"
    there = Counter(one.side for one in trainings)
    more = " and ".join(f"{max(0, number - count)}" for count in dict.fromkeys(there.values()))
    return f"about {number} training seeds on each side, {more} more,"


def trainings_table(trainings: Sequence[TrainingValue], effect: Effect) -> tables.Table:
    """Lay out an effect's metric in the run of each training seed."""
    rows = tuple(
        tables.make_row(printable(one.path), one.side, format_value(effect.metric, one.value))
        for one in trainings
    )
    columns = tables.make_columns("Side", f"{task_title(effect.task)} {effect.metric}")
    return tables.Table("Training seeds", ("Run",), columns, rows)


def answer_line(found: MethodComparison) -> str:
    """Say in one sentence what was found, and how many seeds would say more."""
    main, effect = found.main, found.main.effect
    values = (format_value(effect.metric, one) for one in (effect.first, effect.second))
    in_both = ", ".join(map(" ".join, zip(SIDES, values, strict=True)))
    answer = f"{main.verdict}: {effect.task} {effect.metric} {in_both}"
    if main.p_adjusted > ALPHA and effect.differing:
        number = seeds_in_words(main.needed, found.trainings)
        answer += f"; {number} would decide if the difference is as observed"
    return answer
