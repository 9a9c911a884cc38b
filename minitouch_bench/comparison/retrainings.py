"""The gate over retrainings: whether a method got worse, by one run of each of its training seeds.

A gate on one checkpoint cannot tell a worse method from an unlucky training seed.
"""

import math
import shlex
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from minitouch_bench.comparison.gate import (
    MOST_SEEDS,
    Decision,
    Endpoint,
    GateResult,
    GateSettings,
    TrainingValue,
    decide,
    endpoint_values,
    judge_runs,
    judge_tasks,
    refuse_other_rules,
    task_values,
)
from minitouch_bench.comparison.pairing import ComparedRun, Effect, PairedValues, pair_runs
from minitouch_bench.comparison.power import FEWEST_FOR_A_MEAN
from minitouch_bench.errors import UsageError, printable
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.intervals import INTERVAL_ENDS, Estimate, newcombe, wilson
from minitouch_bench.metrics.seeds import MeanDifferences, mean_differences
from minitouch_bench.metrics.statistics import POWER, SHARE
from minitouch_bench.reporting.labels import tasks_in_order
from minitouch_bench.runs.run import Run

TITLES = ("baseline", "candidate")

OVER_TRAININGS = "Student's t over training seeds, of shares no narrower than over all episodes"

Sides = tuple[Sequence[Run], Sequence[Run]]
"""The runs of the baseline's training seeds, and of the candidate's."""


def judge(sides: Sides, paths: Sequence[Sequence[str]], settings: GateSettings) -> GateResult:
    """Judge a candidate's run beside the baseline's, or the runs of a method's training seeds.

    Raises:
        UsageError: see ``judge_runs`` and ``judge_trainings``.
    """
    (baseline, *more), (candidate, *others) = sides
    if more or others:
        return judge_trainings(sides, paths, settings)
    return judge_runs(baseline, candidate, (paths[0][0], paths[1][0]), settings)


def judge_trainings(
    sides: Sides, paths: Sequence[Sequence[str]], settings: GateSettings
) -> GateResult:
    """Judge a method by the runs of its training seeds, beside those of the baseline.

    Raises:
        UsageError: a side has one run, or one training twice; there are too few episodes; the runs
            are not of the same episodes, or have none of the metric.
    """
    first, runs = sides[0][0], [run for side in sides for run in side]
    for side, title in zip(sides, TITLES, strict=True):
        _refuse_one_training(side, title)
    for run in runs:
        refuse_other_rules(first, run.header)
    pairs = [[pair_runs(first, run) for run in side] for side in sides]
    tasks = tasks_in_order((first,))
    deciding = [[endpoint_values(one, tasks, settings) for one in side] for side in pairs]
    if (episodes := len(deciding[0][0].first)) < FEWEST_FOR_A_MEAN:
        raise UsageError(
            f"a gate over training seeds needs {FEWEST_FOR_A_MEAN} episodes, not {episodes}: "
            "evaluate all runs again with more"
        )
    found, effect = compare_trainings(deciding)
    endpoint = decide(effect, deciding[0][0].tasks, settings, is_believed=True)
    digests = [sorted(run.digest for run in side) for side in sides]
    if identical := digests[0] == digests[1]:
        endpoint = replace(endpoint, decision=Decision.NO_REGRESSION)
    if endpoint.decision.is_open:
        number = scipy.stats.hmean([len(side) for side in sides])
        needed = seeds_needed(found, endpoint, number, settings.alpha)
        endpoint = replace(endpoint, decision=Decision.NOT_ENOUGH_SEEDS, seeds_needed=needed)
    by_metric = [[*zip(*(task_values(one, tasks) for one in side), strict=True)] for side in pairs]
    effects = [
        compare_trainings(both)[1]
        for both in zip(*by_metric, strict=True)
        if METRICS[both[0][0].metric].statistic.is_additive
    ]
    shown = [
        [ComparedRun.of(title, run, path) for run, path in zip(side, places, strict=True)]
        for title, side, places in zip(TITLES, sides, paths, strict=True)
    ]
    listed = [path for side in paths for path in side]
    return GateResult(
        baseline=_joined(shown[0]),
        candidate=_joined(shown[1]),
        decision=endpoint.decision,
        settings=settings,
        identical=identical,
        endpoint=endpoint,
        per_task=judge_tasks(effects, endpoint, settings.alpha),
        changes=(),
        notes=(),
        next_command=shlex.join(["minitouch-bench", "report", *map(printable, listed)]),
        wall_s=sum(run.environment.wall_s for run in sides[1]),
        trainings=tuple(
            TrainingValue(run, float(values.second.mean()))
            for of_side, side in zip(shown, deciding, strict=True)
            for run, values in zip(of_side, side, strict=True)
        ),
    )


def _refuse_one_training(side: Sequence[Run], title: str) -> None:
    if len(side) < 2:
        raise UsageError(
            f"the {title} has one run: give one run on each side, or on both two or more, one of "
            "each training seed"
        )
    policies = [run.header.policy.digest or run.digest for run in side]
    for kept in (policies, [run.digest for run in side]):
        if len({*kept}) < len(kept):
            raise UsageError(f"two runs of the {title} are of one training: give each one once")


def _joined(runs: Sequence[ComparedRun]) -> ComparedRun:
    """Return the runs of one side under one name."""
    labels = tuple(dict.fromkeys(label for run in runs for label in run.labels))
    path = ", ".join(run.path for run in runs)
    return ComparedRun(runs[0].title, f"{len(runs)} trainings", path, labels)


def compare_trainings(
    sides: Sequence[Sequence[PairedValues]],
) -> tuple[MeanDifferences, Effect]:
    """Estimate the difference of the candidate's mean and the baseline's, and test it against 0.

    ``sides``: a metric of a task in each run, the second of the pair being the run itself. The
    unit is the training seed: see ``mean_differences``.
    """
    like = sides[0][0]
    metric = METRICS[like.metric]
    if not metric.statistic.is_additive:
        raise UsageError(f"{like.metric} has no test over training seeds")
    before, after = (np.array([values.second for values in side]) for side in sides)
    found = mean_differences([[after, before]])
    value, variance, freedom = (
        float(table[0, 1]) for table in (found.value, found.variance, found.freedom)
    )
    reach = float(scipy.stats.t.ppf(INTERVAL_ENDS[1], freedom)) * math.sqrt(variance)
    low, high = value - reach, value + reach
    if metric.statistic == SHARE:
        shares = (wilson(round(won.sum()), won.size) for won in (after, before))
        over_episodes = newcombe(*shares)
        low, high = min(low, over_episodes.low), max(high, over_episodes.high)
    least, most = metric.range_in(like.task, difference=True)
    seeds = len(before) + len(after)
    return found, Effect(
        task=like.task,
        metric=like.metric,
        unit=metric.unit_in(like.task),
        direction=like.direction,
        first=float(before.mean()),
        second=float(after.mean()),
        difference=Estimate(value, max(low, least), min(high, most), seeds, OVER_TRAININGS),
        p_value=float(found.p_values[0, 1]),
        differing=int(np.count_nonzero(before.mean(axis=0) != after.mean(axis=0))),
    )


def seeds_needed(
    found: MeanDifferences, endpoint: Endpoint, seeds: float, level: float
) -> int | None:
    """Return the training seeds on each side that settle a difference in four of five cases.

    ``seeds``: how many there are now. None for more than MOST_SEEDS.
    """
    episodes = float(found.over_episodes[0, 1])
    of_seed = (float(found.variance[0, 1]) - episodes) * seeds
    distance = endpoint.effect.worsening - endpoint.tolerance
    for number in range(math.floor(seeds) + 1, MOST_SEEDS + 1):
        error = math.sqrt(episodes + of_seed / number)
        quantiles = (1.0 - level, INTERVAL_ENDS[1], POWER)
        shown, excluded, power = scipy.stats.t.ppf(quantiles, 2 * number - 2) * error
        if endpoint.is_beyond:
            is_enough = endpoint.effect.worsening >= shown + power and distance >= power
        else:
            is_enough = -distance >= excluded + power
        if is_enough:
            return number
    return None
