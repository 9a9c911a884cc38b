from dataclasses import dataclass

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
    assert significant_drops([found] * 8) == (found,) * 8


def test_an_honest_policy_stays_and_a_better_one_too():
    for successes in (17, 20):
        found = compare_fresh(shares(90, 100), shares(successes, 20), Role.FINAL, "opening")
        assert significant_drops([found]) == ()


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
                refused += likely * bool(significant_drops([found] * tasks))
    assert 1 - (1 - refused) ** tasks <= 0.01


def test_playing_is_compared_by_its_touch_share():
    held = [Episode(touch_steps=100 + turn) for turn in range(100)]
    lost = [Episode(touch_steps=4 + turn) for turn in range(20)]
    found = compare_fresh(held, lost, Role.FINAL, "playing")
    assert found.metric == "touch_share"
    assert significant_drops([found]) == (found,)
    assert significant_drops([compare_fresh(held, held[::5], Role.FINAL, "playing")]) == ()


def test_a_small_drop_everywhere_is_seen_where_no_single_one_is():
    found = [compare_fresh(shares(100, 100), shares(47, 50), Role.FINAL, "opening")] * 15
    assert significant_drops(found) == ()
    assert drop_together(found) < 1e-6
    assert drop_together(found[:1]) is None


@pytest.mark.parametrize("rate", [0.5, 0.9, 0.99])
def test_an_honest_submission_is_hardly_ever_refused_for_all_drops_together(rate):
    rng = np.random.default_rng(0)
    drawn = rng.binomial((100, 50), rate, (2000, 4, 2))
    found = {
        pair: compare_fresh(shares(pair[0], 100), shares(pair[1], 50), Role.FINAL, "opening")
        for pair in set(map(tuple, drawn.reshape(-1, 2).tolist()))
    }
    together = (drop_together([found[tuple(one)] for one in row]) for row in drawn.tolist())
    assert sum(p is not None for p in together) <= 2000 * 0.005 + 10
