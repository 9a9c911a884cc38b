from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from scipy import stats

from minitouch_bench.records import Outcome, Role
from minitouch_bench.verification.fresh import (
    compare_fresh,
    drop_together,
    fresh_seed,
    new_draw,
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


def test_the_seed_follows_from_checkpoint_and_draw_alone():
    seed = fresh_seed("ab" * 32, "phrase")
    assert seed == fresh_seed("ab" * 32, "phrase")
    assert 2**200 < seed < 2**256
    assert seed not in {fresh_seed("ab" * 32, "phrases"), fresh_seed("ac" * 32, "phrase")}
    assert new_draw() != new_draw()


def test_a_table_of_stored_actions_drops_beyond_doubt():
    found = compare_fresh(shares(100, 100), shares(0, 20), Role.FINAL, "opening")
    assert (found.metric, found.official, found.fresh, found.episodes) == ("success", 1.0, 0.0, 20)
    assert significant_drops([found] * 8, 8) == (found,) * 8


def test_an_honest_policy_stays_and_a_better_one_too():
    for successes in (17, 20):
        found = compare_fresh(shares(90, 100), shares(successes, 20), Role.FINAL, "opening")
        assert significant_drops([found], 1) == ()


@pytest.mark.parametrize("rate", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("tasks", [1, 4, 7])
def test_an_honest_submission_is_refused_in_one_of_a_hundred_at_most(rate, tasks):
    refused = 0.0
    official, fresh = stats.binom(100, rate), stats.binom(20, rate)
    for first in range(101):
        for second in range(21):
            likely = official.pmf(first) * fresh.pmf(second)
            if likely > 1e-9:
                found = compare_fresh(shares(first, 100), shares(second, 20), Role.FINAL, "opening")
                refused += likely * bool(significant_drops([found] * tasks, tasks))
    assert 1 - (1 - refused) ** tasks <= 0.01


def test_playing_is_compared_by_its_touch_share():
    held = [Episode(touch_steps=100 + turn) for turn in range(100)]
    lost = [Episode(touch_steps=4 + turn) for turn in range(20)]
    found = compare_fresh(held, lost, Role.FINAL, "playing")
    assert found.metric == "touch_share"
    assert significant_drops([found], 1) == (found,)
    assert significant_drops([compare_fresh(held, held[::5], Role.FINAL, "playing")], 1) == ()


def test_a_small_drop_in_every_task_is_seen_where_no_single_one_is():
    small = [compare_fresh(shares(100, 100), shares(46, 50), Role.FINAL, "opening")] * 3
    assert significant_drops(small, 3) == ()
    assert drop_together([small]) < 0.001
    assert drop_together([small[:1]]) is None


@pytest.mark.parametrize("rate", [0.5, 0.9, 0.99])
def test_honest_training_seeds_on_the_same_scenes_are_hardly_ever_refused(rate):
    """Five seeds, three tasks; half of an episode's variance is that of its scene."""
    rng, compare = np.random.default_rng(0), cache(compare_counts)

    def play(episodes):
        scene, own = rng.random((3, episodes)) < rate, rng.random((5, 3, episodes)) < rate
        return np.where(rng.random(own.shape) < 0.5, scene, own).sum(axis=2).tolist()

    refused = 0
    for _ in range(1000):
        by_seed = [
            [compare(*counts) for counts in zip(*tasks, strict=True)]
            for tasks in zip(play(100), play(50), strict=True)
        ]
        refused += drop_together(by_seed) is not None
    assert refused <= 13  # of 1,000 at 0.5 %: more are seen once in a thousand times


def compare_counts(first, second):
    return compare_fresh(shares(first, 100), shares(second, 50), Role.FINAL, "opening")
