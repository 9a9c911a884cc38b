"""Two methods by their training seeds: the test, the numbers of seeds, and what is printed."""

import json

import numpy as np
import pytest

from minitouch_bench.comparison.methods import (
    answer_line,
    compare_method_runs,
    methods_json,
    methods_markdown,
)
from minitouch_bench.comparison.retrainings import training_differences
from minitouch_bench.errors import UsageError
from minitouch_bench.leaderboard.ranking import rank
from minitouch_bench.metrics.statistics import seeds_to_decide
from minitouch_bench.perturbation import Perturbation
from minitouch_bench.runs.run import Run
from tests.comparison.pairs import draw, with_header
from tests.comparison.test_retrainings import PairedValues, trainings, with_policies

GOOD = with_policies(trainings("good", [0.85, 0.9, 0.95, 0.9]))
BAD = with_policies(trainings("bad", [0.5, 0.4, 0.6]))
NEAR = with_policies(trainings("near", [0.75, 0.85, 0.9, 0.8]))


def compared(*sides: list[Run]):
    return compare_method_runs(sides, [[f"runs/{run.name}" for run in side] for side in sides])


def row(comparison, task, metric="success"):
    return next(
        one
        for one in comparison.metrics
        if (one.effect.task, one.effect.metric) == (task, metric)
    )  # fmt: skip


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
    comparison = compared(GOOD, NEAR)
    assert comparison.main.verdict == "no difference seen"
    number = comparison.main.to_decide
    assert f"about {number} training seeds on each side, {number - 4} more," in str(comparison)
    assert row(comparison, "pushing", "episode_steps").to_find is None
    assert answer_line(comparison) in methods_markdown(comparison)
    assert json.loads(methods_json(comparison))["main"]["to_decide"] == number


def test_the_seeds_for_a_difference_of_a_tenth_find_it_in_four_of_five_studies():
    rng = np.random.default_rng(5)

    def study(skill, seeds):
        sides = [
            [draw(rng, own, hardness).success * 1.0 for own in rng.normal(mean, 0.08, seeds)]
            for mean in (skill, 0.6)
        ]
        first = sides[0][0]
        return training_differences(
            [[PairedValues("pushing", "success", ("pushing",), first, own) for own in side]
             for side in sides]
        )  # fmt: skip

    hardness = rng.random(100)
    guesses = [seeds_to_decide(study(0.6, 8), (8, 8), 0.05, 0.1) for _ in range(60)]
    needed = int(np.median([guess for guess in guesses if guess]))
    assert 6 < needed < 40
    found = [study(0.7, needed).p_values[0, 1] <= 0.05 for _ in range(300)]
    assert 0.65 < np.mean(found) < 0.93


@pytest.mark.parametrize(
    ("a", "b", "why"),
    [
        (GOOD, BAD[:1], "--b names 1"),
        ([], BAD, "--a names 0"),
        (GOOD, [BAD[0], BAD[0]], "two runs of the B are of one training"),
        (GOOD, trainings("few", [0.5, 0.6])[:1] * 2, "of one training"),
    ],
)
def test_what_is_not_several_trainings_of_two_methods_is_refused(a, b, why):
    with pytest.raises(UsageError, match=why):
        compared(a, b)


def test_runs_of_one_side_under_several_conditions_are_refused():
    conditions = Perturbation(without=("forces",))
    mixed = [with_header(BAD[0], conditions=conditions), *BAD[1:]]
    with pytest.raises(UsageError, match="their conditions differ"):
        compared(GOOD, mixed)
    blind = [with_header(run, conditions=conditions) for run in BAD]
    assert compared(GOOD, blind).main.verdict == "A is better"
