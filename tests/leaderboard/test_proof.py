from dataclasses import dataclass
from itertools import chain

import numpy as np
import pytest
from scipy import stats

from minitouch_bench.episode import Outcome, Role
from minitouch_bench.leaderboard import proof
from minitouch_bench.leaderboard.proof import (
    Values,
    compare_fresh,
    drop_together,
    fresh_seed,
    significant_drops,
)


@dataclass(frozen=True)
class Episode:
    """What the two ranking metrics read of an episode."""

    success: bool = False
    outcome: Outcome = Outcome.STEP_LIMIT
    touch_steps: int = 0
    steps: int = 200


def shares(successes, number):
    return [Episode(success=turn < successes) for turn in range(number)]


def compare(official, fresh, task="opening"):
    return compare_fresh(Values.of(task, official, fresh), Role.FINAL, task)


def groups(by_task, role=Role.FINAL, suite="table4"):
    """Number the tasks of some groups of values."""
    return {(role, suite, f"task {turn}"): seeds for turn, seeds in enumerate(by_task)}


def test_the_seed_follows_from_checkpoint_and_draw_alone():
    seed = fresh_seed("ab" * 32, "phrase")
    assert seed == fresh_seed("ab" * 32, "phrase")
    assert 2**200 < seed < 2**256
    assert seed not in {fresh_seed("ab" * 32, "phrases"), fresh_seed("ac" * 32, "phrase")}


def test_a_table_of_stored_actions_drops_beyond_doubt():
    found = compare(shares(100, 100), shares(0, 20))
    assert (found.metric, found.official, found.fresh, found.episodes) == ("success", 1.0, 0.0, 20)
    assert significant_drops([found] * 8, 8) == (found,) * 8


@pytest.mark.parametrize("rate", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("tasks", [1, 4, 7])
def test_an_honest_submission_is_refused_in_one_of_a_hundred_at_most(rate, tasks):
    refused = 0.0
    official, fresh = stats.binom(100, rate), stats.binom(20, rate)
    for first in range(101):
        for second in range(21):
            likely = official.pmf(first) * fresh.pmf(second)
            if likely > 1e-9:
                found = compare(shares(first, 100), shares(second, 20))
                refused += likely * bool(significant_drops([found] * tasks, tasks))
    assert 1 - (1 - refused) ** tasks <= 0.01


def test_playing_is_compared_by_its_touch_share():
    held = [Episode(touch_steps=100 + turn) for turn in range(100)]
    lost = [Episode(touch_steps=4 + turn) for turn in range(20)]
    found = compare(held, lost, "playing")
    assert found.metric == "touch_share"
    assert significant_drops([found], 1) == (found,)
    assert significant_drops([compare(held, held[::5], "playing")], 1) == ()


def test_a_few_stored_episodes_of_playing_are_seen_in_the_mean_that_ranks():
    """A quarter of the official episodes is stored; the rank of most says nothing of them."""
    rng = np.random.default_rng(0)
    honest = [Episode(touch_steps=int(steps)) for steps in rng.geometric(0.1, 125)]
    stored = [Episode(touch_steps=198)] * 25
    found = compare(stored + honest[:75], honest[75:], "playing")
    assert found.p < 1e-4
    assert significant_drops([found] * 35, 35)


def test_a_small_drop_in_every_task_is_seen_where_no_single_one_is():
    assert significant_drops([compare(shares(100, 100), shares(46, 50))] * 3, 3) == ()
    small = [Values.of("opening", shares(100, 100), shares(46, 50))]
    assert drop_together(groups([small] * 3)) < 0.001
    assert drop_together(groups([small])) is None
    assert drop_together({}) is None
    assert drop_together(groups([small, small]) | groups([small], suite="novel-shapes")) < 0.001


def test_a_small_drop_in_every_training_seed_is_seen():
    rng = np.random.default_rng(0)
    play = lambda rate, number: tuple((rng.random(number) < rate).astype(float).tolist())  # noqa: E731
    seeds = [Values(play(0.9, 100), play(0.8, 50)) for _ in range(20)]
    assert drop_together(groups([seeds])) < 1e-4
    assert drop_together(groups([seeds[:1]])) is None


def test_seeds_without_any_variation_have_a_verdict():
    same, worse = Values((1.0,) * 100, (1.0,) * 50), Values((1.0,) * 100, (0.0,) * 50)
    assert drop_together(groups([[same] * 5] * 3)) is None
    assert drop_together(groups([[worse] * 5])) < 1e-30


def of(successes, number):
    return (1.0,) * successes + (0.0,) * (number - successes)


def test_an_exploration_policy_that_drops_in_every_training_seed_is_seen():
    """Each seed shows 0.28 officially and 0.04 in fresh episodes; the final policy is honest."""
    rng = np.random.default_rng(0)
    sides = [[of(28, 100), of(2, 50)] for _ in range(5)]
    dropped = [Values(*(tuple(rng.permutation(side)) for side in one)) for one in sides]
    alone = [compare_fresh(one, Role.EXPLORATION, "pushing") for one in dropped]
    assert significant_drops(alone, planned=5 * 7) == ()
    final = groups([[Values(of(60, 100), of(30, 50))] * 5] * 3)
    assert drop_together(final) is None
    assert drop_together(final | groups([dropped], Role.EXPLORATION)) < 1e-4


@pytest.mark.parametrize(
    ("rate", "number", "episodes"), [(0.02, 2, 20), (0.5, 5, 50), (0.99, 5, 50)]
)
def test_honest_training_seeds_on_the_same_scenes_are_hardly_ever_refused(
    monkeypatch, rate, number, episodes
):
    """Three tasks, two policies; half of an official episode's variance is that of its scene."""
    monkeypatch.setattr(proof, "ORDERS", 1000)
    rng = np.random.default_rng(0)

    def play(task):
        scene = rng.random(100) < rate
        for role in Role:
            own, same = rng.random((number, 100)) < rate, rng.random((number, 100)) < 0.5
            official = np.where(same, scene, own).astype(float)
            new = (rng.random((number, episodes)) < rate).astype(float)
            pairs = zip(official, new, strict=True)
            yield (role, "table4", task), [Values(*map(tuple, pair)) for pair in pairs]

    drops = (drop_together(dict(chain(*map(play, "abc")))) for _ in range(100))
    assert sum(p is not None for p in drops) <= 4  # more are seen once in five thousand times
