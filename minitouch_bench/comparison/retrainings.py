"""The gate over retrainings: whether a method got worse, by one run of each of its training seeds.

A gate on one checkpoint cannot distinguish a worse method from an unlucky training seed.
"""

import math
import shlex
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from minitouch_bench.comparison import gate, pairing
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics import intervals
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.statistics import FEWEST_FOR_A_MEAN, SHARE
from minitouch_bench.reporting.labels import run_labels, tasks_in_order
from minitouch_bench.runs.run import Run
from minitouch_bench.text import printable

TITLES = ("baseline", "candidate")

OVER_TRAININGS = "Student's t over training seeds, of shares no narrower than over all episodes"

Sides = tuple[Sequence[Run], Sequence[Run]]
"""The runs of the baseline's training seeds, and of the candidate's."""


def judge(
    sides: Sides, paths: Sequence[Sequence[str]], settings: gate.GateSettings
) -> gate.GateResult:
    """Judge a candidate's run beside the baseline's, or the runs of a method's training seeds.

    Raises:
        UsageError: see ``judge_runs`` and ``judge_trainings``.
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
    notes = tuple(pairing.exploration_left_out([*sides[0], *sides[1]]))
    shared = pairing.share_roles([*sides[0], *sides[1]])
    sides = shared[: len(sides[0])], shared[len(sides[0]) :]
    first, tasks = sides[0][0], tasks_in_order(sides[0][:1])
    deciding, by_metric, sets = [], [], []
    trainings: list[gate.TrainingValue] = []
    for title, side, places in zip(TITLES, sides, paths, strict=True):
        _refuse_one_training(side, title)
        for run in side:
            gate.refuse_other_rules(first, run.header)
        pairs = [pairing.pair_runs(first, run) for run in side]
        values = [gate.endpoint_values(one, tasks, settings) for one in pairs]
        deciding.append(values)
        by_metric.append(zip(*(gate.task_values(one, tasks) for one in pairs), strict=True))
        labels = tuple(dict.fromkeys(label for run in side for label in run_labels(run)))
        name = f"{len(side)} trainings"
        sets.append(pairing.ComparedRun(title, name, ", ".join(places), labels))
        means = (float(one.second.mean()) for one in values)
        trainings += map(gate.TrainingValue, [title] * len(side), places, means)
    if (episodes := len(deciding[0][0].first)) < FEWEST_FOR_A_MEAN:
        raise UsageError(
            f"a gate over training seeds needs {FEWEST_FOR_A_MEAN} episodes, not {episodes}: "
            "evaluate all runs again with more"
        )
    effect = compare_trainings(deciding)
    endpoint = gate.decide(effect, deciding[0][0].tasks, settings, is_believed=True)
    if endpoint.decision.is_open:
        endpoint = replace(endpoint, decision=gate.Decision.NOT_ENOUGH_SEEDS)
    effects = [compare_trainings(both) for both in zip(*by_metric, strict=True)]
    shown = (printable(one.path) for one in trainings)
    return gate.GateResult(
        sets[0], sets[1], endpoint.decision, settings, False, endpoint,
        gate.judge_tasks(effects, endpoint, settings.alpha), changes=(), notes=notes,
        next_command=shlex.join(["minitouch-bench", "report", *shown]),
        wall_s=sum(run.environment.wall_s for run in sides[1]),
        trainings=tuple(trainings),
    )  # fmt: skip


def _refuse_one_training(side: Sequence[Run], title: str) -> None:
    if len(side) < 2:
        raise UsageError(
            f"the {title} has one run: give one run on each side, or on both two or more, one of "
            "each training seed"
        )
    known = [[run.header.policy.digest or run.digest, run.digest] for run in side]
    if any(len({*digests}) < len(side) for digests in zip(*known, strict=True)):
        raise UsageError(f"two runs of the {title} are of one training: give each one once")


def compare_trainings(sides: Sequence[Sequence[pairing.PairedValues]]) -> pairing.Effect:
    """Estimate the difference of the candidate's mean and the baseline's, and test it against 0.

    ``sides``: a metric of a task in each run, the second of the pair being the run itself. The
    unit is the training seed: see ``mean_differences``.
    """
    like = sides[0][0]
    metric = METRICS[like.metric]
    before, after = (np.array([values.second for values in side]) for side in sides)
    found = intervals.mean_differences([[after, before]])
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
    return pairing.Effect(
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
