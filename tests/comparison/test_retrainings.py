"""The gate over training seeds: its decision, its rates on known truth, and what it prints."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from minitouch_bench.comparison.gate import Decision, GateSettings, decide
from minitouch_bench.comparison.gate_report import gate_json, gate_markdown, show_result
from minitouch_bench.comparison.pairing import PairedValues
from minitouch_bench.comparison.retrainings import compare_trainings, judge
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.intervals import newcombe, wilson
from tests.comparison.pairs import draw, flags, make_saved, shown, values, with_header

N = 40
HARDNESS = np.random.default_rng(7).random((2, N))
"""Of the episodes of two tasks, the same for every run."""


def trainings(name, skills, seed=0):
    """A run of each training seed, whose policies have these skills."""
    rng = np.random.default_rng([seed, len(name)])
    tasks = dict(zip(("pushing", "opening"), HARDNESS, strict=True))
    return [
        make_saved(
            {task: draw(rng, skill, hard) for task, hard in tasks.items()}, f"{name}-{number}"
        )
        for number, skill in enumerate(skills)
    ]


def judged(before, after, **settings):
    paths = [[f"runs/{run.name}" for run in side] for side in (before, after)]
    return judge((with_policies(before), with_policies(after)), paths, GateSettings(**settings))


def with_policies(side):
    """Each run has a policy file of its own."""
    return [with_header(run, policy=replace(run.header.policy, digest=run.name)) for run in side]


GOOD = trainings("good", [0.85, 0.9, 0.95, 0.9])


def test_a_worse_method_is_a_regression_and_each_seed_is_shown():
    bad = trainings("bad", [0.5, 0.4, 0.6])
    result = judged(GOOD, bad)
    assert (result.decision, result.exit_code) == (Decision.REGRESSION, 1)
    assert [one.side for one in result.trainings] == ["baseline"] * 4 + ["candidate"] * 3
    means = [np.mean([row.success for row in run.rows]) for run in (*GOOD, *bad)]
    assert [one.value for one in result.trainings] == pytest.approx(means)
    difference = result.endpoint.effect.difference
    assert difference.value == pytest.approx(np.mean(means[4:]) - np.mean(means[:4]))
    assert (difference.count, result.changes) == (7, ())
    assert {"pushing", "opening"} == {one.effect.task for one in result.per_task if one.is_worse}
    screen = shown(show_result, result)
    for run in (*GOOD, *bad):
        assert f"runs/{run.name}" in screen
        assert f"runs/{run.name}" in gate_markdown(result)
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
    bad = trainings("bad", [0.5, 0.4, 0.6])
    result = judged(explored, bad)
    assert result.decision is Decision.REGRESSION
    assert "exploration" not in {one.effect.metric for one in result.per_task}
    assert ["exploration is left out" in note for note in result.notes] == [True]
    assert judged(GOOD, bad).notes == ()


def test_an_equal_method_of_steady_seeds_is_no_regression():
    steady = [
        make_saved({"pushing": values(np.roll(flags(98, 100), shift))}, f"steady-{shift}")
        for shift in range(8)
    ]
    result = judged(steady[::2], steady[1::2])
    assert (result.decision, result.exit_code) == (Decision.NO_REGRESSION, 0)


def test_seeds_that_agree_by_chance_leave_the_doubt_of_their_episodes():
    perfect = [make_saved({"pushing": values(flags(20, 20))}, f"p-{n}") for n in range(4)]
    effect = judged(perfect[:2], perfect[2:]).endpoint.effect
    expected = newcombe(wilson(40, 40), wilson(40, 40))
    assert (effect.difference.low, effect.difference.high) == (expected.low, expected.high)
    assert effect.p_value == 1


def test_the_same_trainings_again_are_no_regression():
    again = [replace(run, name=f"again-{run.name}") for run in GOOD]
    result = judged(GOOD, again)
    assert result.decision is not Decision.REGRESSION
    assert {one.effect.p_value for one in (result.endpoint, *result.per_task)} == {1}
    assert json.loads(gate_json(result))


def test_control_steps_are_compared_over_several_tasks():
    slow, fast = (
        [
            make_saved(
                {task: values([True] * 10, [n] * 10) for task in ("pushing", "opening")}, str(n)
            )
            for n in numbers
        ]
        for numbers in ((90, 92), (10, 12))
    )
    effect = judged(fast, slow, metric="episode_steps").endpoint.effect
    assert (effect.task, effect.difference.value) == ("mean", 80)
    assert effect.difference.high <= 200


def test_seeds_that_differ_have_welch_s_interval_where_episodes_add_nothing():
    """By hand: the episodes of a seed are all alike, so that the seeds' means are all there is."""
    steps = {"a": [10, 20, 40], "b": [60, 90]}
    sides = [
        [make_saved({"pushing": values([True] * 10, [n] * 10)}, f"{side}-{n}") for n in numbers]
        for side, numbers in steps.items()
    ]
    effect = judged(*sides, metric="episode_steps").endpoint.effect
    welch = stats.ttest_ind(steps["b"], steps["a"], equal_var=False)
    assert effect.p_value == pytest.approx(welch.pvalue)
    interval = welch.confidence_interval()
    assert effect.difference.low == pytest.approx(interval.low)
    assert effect.difference.high == pytest.approx(interval.high)


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        (GOOD[:1], GOOD[1:3], "the baseline has one run"),
        (GOOD[:2], GOOD[2:3], "the candidate has one run"),
        (GOOD[:2], [GOOD[2], GOOD[2]], "two runs of the candidate are of one training"),
        (GOOD[:2], [GOOD[2], make_saved({"pushing": values(flags(9, N))}, "x")], "episodes differ"),
    ],
)  # fmt: skip
def test_what_is_not_one_run_per_training_seed_is_refused(before, after, why):
    with pytest.raises(UsageError, match=why):
        judged(before, after)


def test_false_alarms_stay_near_their_level_and_a_worse_method_is_found():
    """Seeds' skills vary normally; their runs share the hardness of the episodes."""
    rng = np.random.default_rng(3)

    def regressions(skill, gates=300):
        found = 0
        for _ in range(gates):
            hardness = rng.random(100)
            sides = [
                [draw(rng, own, hardness).success * 1.0 for own in rng.normal(mean, 0.05, 5)]
                for mean in (0.8, skill)
            ]
            paired = [
                [PairedValues("pushing", "success", ("pushing",), sides[0][0], own) for own in side]
                for side in sides
            ]
            effect = compare_trainings(paired)
            decided = decide(effect, ("pushing",), GateSettings(), is_believed=True)
            found += decided.decision is Decision.REGRESSION
        return found / gates

    assert regressions(0.8) <= 0.05 + 3 * (0.05 * 0.95 / 300) ** 0.5
    assert regressions(0.6) >= 0.9
