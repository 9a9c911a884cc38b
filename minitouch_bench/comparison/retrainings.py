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
from minitouch_bench.metrics.statistics import ALPHA, FEWEST_FOR_A_MEAN, SHARE, seeds_to_decide
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
    first, tasks = sides[0][0], tasks_in_order(sides[0][:1])
    deciding, by_metric, sets = [], [], []
    trainings: list[gate.TrainingValue] = []
    for title, side in zip(TITLES, sides, strict=True):
        if len(side) < 2:
            raise UsageError(
                f"the {title} has one run: give one run on each side, or on both two or more, one "
                "of each training seed"
            )
        for run in side:
            gate.refuse_other_rules(first, run.header)
    paired = pair_trainings(sides, TITLES)
    for title, side, pairs, places in zip(TITLES, sides, paired, paths, strict=True):
        values = [gate.endpoint_values(one, tasks, settings) for one in pairs]
        deciding.append(values)
        by_metric.append(zip(*(gate.task_values(one, tasks) for one in pairs), strict=True))
        sets.append(side_of(title, side, places))
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
        needed = _seeds_needed(deciding, endpoint, settings.alpha)
        open_decision = gate.Decision.NOT_ENOUGH_SEEDS
        endpoint = replace(endpoint, decision=open_decision, seeds_needed=needed)
    effects = [compare_trainings(both) for both in zip(*by_metric, strict=True)]
    shown = (printable(one.path) for one in trainings)
    return gate.GateResult(
        sets[0], sets[1], endpoint.decision, settings, False, endpoint,
        gate.judge_tasks(effects, endpoint, settings.alpha), changes=(), notes=notes,
        next_command=shlex.join(["minitouch-bench", "report", *shown]),
        wall_s=sum(run.environment.wall_s for run in sides[1]),
        trainings=tuple(trainings),
    )  # fmt: skip


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


def side_of(title: str, side: Sequence[Run], paths: Sequence[str]) -> pairing.ComparedRun:
    """Name the runs of one side together."""
    labels = tuple(dict.fromkeys(label for run in side for label in run_labels(run)))
    return pairing.ComparedRun(title, f"{len(side)} trainings", ", ".join(paths), labels)


def _seeds_needed(
    sides: Sequence[Sequence[pairing.PairedValues]], endpoint: gate.Endpoint, alpha: float
) -> int | None:
    """Return about how many seeds of each side show the worsening, or exclude it as observed."""
    found, seeds = training_differences(sides), (len(sides[1]), len(sides[0]))
    distance = abs(endpoint.effect.worsening - endpoint.tolerance)
    if endpoint.is_beyond:  # significant, and beyond the tolerance in four of five cases too
        needed = [
            seeds_to_decide(found, seeds, 2.0 * alpha),
            seeds_to_decide(found, seeds, 1.0, distance),
        ]
    else:
        needed = [seeds_to_decide(found, seeds, ALPHA, distance)]
    if None in needed:
        return None
    return max(min(seeds) + 1, *filter(None, needed))


def training_differences(
    sides: Sequence[Sequence[pairing.PairedValues]],
) -> intervals.MeanDifferences:
    """Compare the means of both sides, the second side's first: see ``mean_differences``."""
    return intervals.mean_differences(
        [[np.array([values.second for values in side]) for side in sides[::-1]]]
    )


def compare_trainings(sides: Sequence[Sequence[pairing.PairedValues]]) -> pairing.Effect:
    """Estimate the difference of the candidate's mean and the baseline's, and test it against 0.

    ``sides``: a metric of a task in each run, the second of the pair being the run itself. The
    unit is the training seed: see ``mean_differences``.
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
