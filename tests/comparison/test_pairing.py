from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from minitouch_bench.comparison.comparison import shared_tasks
from minitouch_bench.comparison.pairing import (
    PairedValues,
    collect_values,
    differences_of_making,
    pair_runs,
    paired_test,
)
from minitouch_bench.errors import UsageError
from tests.comparison.pairs import flags, make_saved, values, with_header

ONE = make_saved({"playing": values(flags(0, 5)), "pushing": values(flags(3, 5))}, "one")
OTHER = make_saved({"playing": values(flags(0, 5)), "pushing": values(flags(4, 5))}, "other")


def test_runs_of_the_same_episodes_are_paired_whatever_their_order():
    pairs = pair_runs(ONE, replace(OTHER, rows=OTHER.rows[::-1]))
    assert [*pairs][4:6] == ["playing/4", "pushing/0"]
    for key, both in pairs.items():
        assert {f"{episode.task}/{episode.index}" for episode in both} == {key}


def test_several_tasks_with_a_goal_have_a_mean_over_all_their_episodes():
    goals = {"pushing": values(flags(3, 5)), "pick-up": values(flags(1, 5))}
    one, other = make_saved(goals, "one"), make_saved({**goals, "pick-up": goals["pushing"]}, "two")
    *_, mean = collect_values(pair_runs(one, other), ("playing", "pushing", "pick-up"))
    assert (mean.task, mean.metric, mean.tasks) == ("mean", "success", ("pushing", "pick-up"))
    np.testing.assert_array_equal(mean.differences, [0, 0, 0, 0, 0, 0, 1, 1, 0, 0])
    more = make_saved({**goals, "pick-up": values(flags(1, 6))})
    unequal = collect_values(pair_runs(more, more), ("pushing", "pick-up"))
    assert "mean" not in {values.task for values in unequal}


def test_a_task_with_other_rules_is_left_out():
    other = with_header(OTHER, task_digests={**OTHER.header.task_digests, "pushing": "ff" * 32})
    pairs = pair_runs(*shared_tasks((ONE, other)))
    assert {first.task for first, _ in pairs.values()} == {"playing"}
    assert next(differences_of_making(ONE, other)) == "pushing is left out: its rules differ"


@pytest.mark.parametrize(
    ("run", "reason"),
    [
        (
            with_header(OTHER, task_digests=dict.fromkeys(OTHER.plan.tasks, "ff" * 32)),
            "protocols differ .*ffffffffffff",
        ),
        (with_header(OTHER, suite="smoke"), "suites differ .table4; smoke"),
        (
            replace(with_header(OTHER, seed=7), directory=Path("hac/table4")),
            "and 'hac/table4' are .*seeds differ .0; 7",  # their paths: all are called table4
        ),
        (replace(OTHER, rows=OTHER.rows[:-2]), "episodes differ .*pushing/3, pushing/4"),
        (
            replace(OTHER, rows=(*OTHER.rows[:-1], replace(OTHER.rows[-1], seed=3))),
            "pushing/4 .*seed 1004.*seed 3",
        ),
    ],
)
def test_what_cannot_be_paired_is_refused_with_the_reason(run, reason):
    with pytest.raises(UsageError, match=reason):
        pair_runs(ONE, run)


# The paired test


def effect_of(metric, first, second):
    return paired_test(PairedValues("pushing", metric, ("pushing",), first, second), (0,))


def has_0(effect):
    return effect.difference.low <= 0 <= effect.difference.high


@pytest.mark.parametrize("n", [5, 6, 9, 30, 100])
def test_an_interval_of_a_share_is_without_0_exactly_where_p_is_small(n):
    for lost in range(n + 1):
        for won in range(0, n - lost + 1, max(1, n // 9)):
            first, second = np.zeros(n), np.zeros(n)
            first[:lost] = 1
            second[lost : lost + won] = 1
            effect = effect_of("success", first, second)
            assert has_0(effect) == (effect.p_value > 0.05), (lost, won)
            assert effect.difference.low <= effect.difference.value <= effect.difference.high


def test_an_interval_of_a_mean_contains_0_where_p_is_large():
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(3, 40))
        effect = effect_of("episode_steps", np.zeros(n), rng.gamma(1, 10, n) - rng.uniform(0, 9))
        assert has_0(effect) or effect.p_value <= 0.05
        assert effect.is_clear == (effect.p_value <= 0.05 and not has_0(effect))
