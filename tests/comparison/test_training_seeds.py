"""Methods by their training seeds: the gate and the comparison of two, on known truth."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from minitouch_bench.comparison.gate import Decision, GateSettings
from minitouch_bench.comparison.gate_report import gate_json, gate_markdown, show_result
from minitouch_bench.comparison.training_seeds import (
    answer_line,
    compare_method_runs,
    judge,
)
from minitouch_bench.errors import UsageError
from minitouch_bench.leaderboard.ranking import rank
from minitouch_bench.metrics.intervals import newcombe, wilson
from minitouch_bench.perturbation import Perturbation
from tests.comparison.pairs import draw, flags, make_saved, shown, values, with_header

N = 40
HARDNESS = np.random.default_rng(7).random((2, N))
"""Of the episodes of two tasks, the same for every run."""


def trainings(name, skills):
    """A run of each training seed, whose policies have these skills."""
    rng = np.random.default_rng([0, len(name)])
    tasks = dict(zip(("pushing", "opening"), HARDNESS, strict=True))
    return [
        make_saved(
            {task: draw(rng, skill, hard) for task, hard in tasks.items()}, f"{name}-{number}"
        )
        for number, skill in enumerate(skills)
    ]


GOOD = trainings("good", [0.85, 0.9, 0.95, 0.9])
BAD = trainings("bad", [0.5, 0.4, 0.6])


def asked(sides):
    """The runs, each with a policy file of its own, and their paths."""
    runs = [
        [with_header(run, policy=replace(run.header.policy, digest=run.name)) for run in side]
        for side in sides
    ]
    return runs, [[f"runs/{run.name}" for run in side] for side in sides]


def judged(*sides, **settings):
    return judge(*asked(sides), GateSettings(**settings))


def compared(*sides):
    return compare_method_runs(*asked(sides))


# The gate


def test_a_worse_method_is_a_regression_and_each_seed_is_shown():
    result = judged(GOOD, BAD)
    assert (result.decision, result.exit_code) == (Decision.REGRESSION, 1)
    assert [one.side for one in result.trainings] == ["baseline"] * 4 + ["candidate"] * 3
    means = [np.mean([row.success for row in run.rows]) for run in (*GOOD, *BAD)]
    assert [one.value for one in result.trainings] == pytest.approx(means)
    difference = result.endpoint.effect.difference
    assert difference.value == pytest.approx(np.mean(means[4:]) - np.mean(means[:4]))
    assert (difference.count, result.changes) == (7, ())
    assert {"pushing", "opening"} == {one.effect.task for one in result.per_task if one.is_worse}
    screen = shown(show_result, result)
    assert all(f"runs/{run.name}" in gate_markdown(result) for run in BAD)
    for run in (*GOOD, *BAD):
        assert f"runs/{run.name}" in screen
    assert len(json.loads(gate_json(result))["trainings"]) == 7


def test_one_unlucky_seed_is_no_regression_of_a_method_as_it_is_of_a_checkpoint():
    unlucky = trainings("unlucky", [0.9, 0.9, 0.95, 0.3])
    assert judged(GOOD[:1], unlucky[3:]).decision is Decision.REGRESSION
    result = judged(GOOD, unlucky)
    assert result.decision is Decision.NOT_ENOUGH_SEEDS
    assert result.exit_code == 5  # what was seen is worse beyond the tolerance
    assert judged(GOOD, unlucky, lenient=True).exit_code == 0
    needed = result.endpoint.seeds_needed
    assert needed > 4
    words = f"about {needed} training seeds on each side, {needed - 4} more, would settle it"
    assert words in shown(show_result, result).replace("\n", " ")


def test_exploration_that_one_training_lacks_is_left_out_and_named():
    explored = [replace(run, exploration_rows=run.rows) for run in GOOD]
    result = judged(explored, BAD)
    assert result.decision is Decision.REGRESSION
    assert "exploration" not in {one.effect.metric for one in result.per_task}
    assert ["exploration is left out" in note for note in result.notes] == [True]
    assert judged(GOOD, BAD).notes == ()


def test_an_equal_method_of_steady_seeds_is_no_regression():
    steady = [
        make_saved({"pushing": values(np.roll(flags(98, 100), shift))}, f"steady-{shift}")
        for shift in range(8)
    ]
    result = judged(steady[::2], steady[1::2])
    assert (result.decision, result.exit_code) == (Decision.NO_REGRESSION, 0)
    again = judged(GOOD, [replace(run, name=f"again-{run.name}") for run in GOOD])
    assert again.decision is not Decision.REGRESSION
    assert {one.effect.p_value for one in (again.endpoint, *again.per_task)} == {1}


def test_seeds_that_agree_by_chance_leave_the_doubt_of_their_episodes():
    perfect = [make_saved({"pushing": values(flags(20, 20))}, f"p-{n}") for n in range(4)]
    effect = judged(perfect[:2], perfect[2:]).endpoint.effect
    expected = newcombe(wilson(40, 40), wilson(40, 40))
    assert (effect.difference.low, effect.difference.high) == (expected.low, expected.high)
    assert effect.p_value == 1


def effect_of_steps(before, after, tasks=("pushing",)):
    """Of training seeds whose episodes all have these numbers of control steps."""
    sides = [
        [make_saved({task: values([True] * 10, [n] * 10) for task in tasks}, str(n)) for n in side]
        for side in (before, after)
    ]
    return judged(*sides, metric="episode_steps").endpoint.effect


def test_seeds_that_differ_have_welch_s_interval_where_episodes_add_nothing():
    """By hand: the episodes of a seed are all alike, so that the seeds' means are all there is."""
    before, after = [10, 20, 40], [60, 90]
    effect = effect_of_steps(before, after)
    welch = stats.ttest_ind(after, before, equal_var=False)
    interval = welch.confidence_interval()
    assert effect.p_value == pytest.approx(welch.pvalue)
    found = effect.difference.low, effect.difference.high
    assert found == pytest.approx((interval.low, interval.high))
    several = effect_of_steps((10, 12), (90, 92), ("pushing", "opening"))
    assert (several.task, several.difference.value) == ("mean", 80)
    assert several.difference.high <= 200


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        (GOOD[:1], GOOD[1:3], "the baseline has one run"),
        (GOOD[:2], GOOD[2:3], "the candidate has one run"),
        (GOOD[:2], [GOOD[2]] * 2, "two runs of the candidate are of one training"),
        (GOOD[:2], [GOOD[2], make_saved({"pushing": values(flags(9, N))}, "x")], "episodes differ"),
    ],
)  # fmt: skip
def test_what_is_not_one_run_per_training_seed_is_refused(before, after, why):
    with pytest.raises(UsageError, match=why):
        judged(before, after)


# The comparison


def row(comparison, task, metric="success"):
    found = {(one.effect.task, one.effect.metric): one for one in comparison.metrics}
    return found[task, metric]


def test_either_side_can_be_better_and_the_test_is_the_board_s():
    forth, back = compared(GOOD, BAD), compared(BAD, GOOD)
    assert (forth.main.verdict, back.main.verdict) == ("A is better", "B is better")
    assert forth.main.p_adjusted == pytest.approx(back.main.p_adjusted)
    assert forth.main.effect.task == "mean"
    rows = {
        name: {
            task: [[float(one.success) for one in run.rows if one.task == task] for run in side]
            for task in ("pushing", "opening")
        }
        for name, side in (("good", GOOD), ("bad", BAD))
    }
    for task, ranking in rank(rows).items():
        found = row(forth, task).effect
        assert ranking.pairs[0].p == pytest.approx(found.p_value, rel=1e-3)
        assert ranking.pairs[0].difference == pytest.approx(-found.difference.value)


def test_an_open_question_says_how_many_seeds_more_would_decide_it():
    comparison = compared(GOOD, trainings("near", [0.75, 0.85, 0.9, 0.8]))
    assert comparison.main.verdict == "no difference seen"
    number = comparison.main.needed
    assert f"about {number} training seeds on each side, {number - 4} more," in str(comparison)
    assert answer_line(comparison) in str(comparison)
    assert json.loads(comparison.to_json())["main"]["needed"] == number


def test_a_task_that_one_run_has_by_other_rules_is_left_out():
    *same, other = BAD
    rules = {**other.header.task_digests, "opening": "ff" * 32}
    found = compared(GOOD, [*same, with_header(other, task_digests=rules)])
    assert {one.effect.task for one in found.metrics} == {"pushing"}
    assert any("opening" in note for note in found.notes)


def test_a_side_of_one_training_or_under_several_conditions_is_refused():
    with pytest.raises(UsageError, match="--b names 1"):
        compared(GOOD, BAD[:1])
    conditions = Perturbation(without=("forces",))
    mixed = [with_header(BAD[0], conditions=conditions), *BAD[1:]]
    with pytest.raises(UsageError, match="their conditions differ"):
        compared(GOOD, mixed)
    blind = [with_header(run, conditions=conditions) for run in BAD]
    assert compared(GOOD, blind).main.verdict == "A is better"
