import math

import numpy as np
import pytest

from minitouch_bench.comparison.pairing import PairedValues, episodes_needed
from minitouch_bench.metrics.intervals import bootstrap
from minitouch_bench.metrics.statistics import FEWEST_FOR_A_MEAN, mcnemar_p, sign_flip_p, tango

TRIALS = 1000
ERROR = 3 * math.sqrt(0.8 * 0.2 / TRIALS)
"""Three standard errors of a share of 0.8 in so many trials."""


def shares(n, lost, won):
    """So many paired outcomes of which only the first, only the second run succeeds."""
    index = np.arange(n)
    first, second = (index < lost).astype(float), (index >= n - won).astype(float)
    return PairedValues("pushing", "success", ("pushing",), first, second)


def means(n, worsening, deviation):
    """Paired control steps: more of them are worse."""
    noise = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    spread = noise.std(ddof=1) if n > 1 else 1.0
    differences = worsening + noise * deviation / spread
    first = np.full(n, 100.0)
    return PairedValues("pushing", "episode_steps", ("pushing",), first, first + differences)


def drawn_shares(n, lost, won, seed):
    return np.random.default_rng(seed).multinomial(n, (lost, won, 1 - lost - won), TRIALS)


@pytest.mark.parametrize("found", [(100, 20, 8), (50, 4, 0), (100, 8, 20), (1000, 120, 100)])
@pytest.mark.parametrize("level", [0.05, 0.005])
def test_so_many_episodes_show_a_difference_of_shares_in_four_of_five_cases(found, level):
    n, lost, won = found
    needed = episodes_needed(shares(*found), level)
    drawn = drawn_shares(needed, lost / n, won / n, seed=1)
    seen = np.mean([mcnemar_p(int(lost), int(won)) <= level for lost, won, _ in drawn])
    assert 0.8 - ERROR <= seen <= 0.96  # by formula, which asks for more where few pairs differ


def test_so_many_episodes_show_a_worsening_beyond_the_tolerance():
    needed = episodes_needed(shares(100, 14, 4), 0.1, 0.05)
    drawn = drawn_shares(needed, 0.14, 0.04, seed=2)
    seen = [mcnemar_p(a, b) <= 0.1 and a - b > 0.05 * needed for a, b, _ in drawn.tolist()]
    assert 0.8 - ERROR <= np.mean(seen) <= 0.86


def test_so_many_episodes_exclude_a_loss_in_four_of_five_cases():
    needed = episodes_needed(shares(100, 4, 4), 0.1, 0.05)
    drawn = drawn_shares(needed, 0.04, 0.04, seed=3)
    known = {(a, b): tango(a, b, needed).low for a, b, _ in drawn.tolist()}
    seen = np.mean([known[a, b] > -0.05 for a, b, _ in drawn.tolist()])
    assert 0.74 <= seen <= 0.86


def test_where_no_pair_differs_the_rule_of_three_gives_the_episodes():
    assert episodes_needed(shares(10, 0, 0), 0.1, 0.05) == 73
    assert tango(0, 0, 73).low >= -0.05 > tango(0, 0, 72).low
    assert episodes_needed(shares(10, 0, 0), 0.05) is None


@pytest.mark.parametrize("worsening", [4.0, -9.0])
def test_so_many_episodes_show_a_difference_of_means_in_four_of_five_cases(worsening):
    needed = episodes_needed(means(100, worsening, 14.0), 0.05)
    rng, trials = np.random.default_rng(2), 600
    seen = np.mean(
        [sign_flip_p(rng.normal(worsening, 14, needed), rng, 1000) <= 0.05 for _ in range(trials)]
    )
    assert abs(seen - 0.8) <= 3 * math.sqrt(0.16 / trials) + 0.02


def test_so_many_episodes_exclude_a_worsening_of_a_mean_in_four_of_five_cases():
    needed = episodes_needed(means(100, 1.0, 14.0), 0.1, 5.0)
    rng, trials = np.random.default_rng(2), 600
    ends = [bootstrap([rng.normal(1.0, 14, needed)], rng, 2000).high for _ in range(trials)]
    assert abs(np.mean([end < 5.0 for end in ends]) - 0.8) <= 3 * math.sqrt(0.16 / trials) + 0.02


def test_means_that_need_no_or_endless_episodes():
    assert episodes_needed(means(20, 0.0, 3.0), 0.05) is None
    assert episodes_needed(means(20, 0.001, 3.0), 0.05) is None  # too many
    assert episodes_needed(means(20, 2.0, 3.0), 0.1, 2.0 + 1e-9) is None
    assert episodes_needed(means(20, 0.0, 0.0), 0.1, 1.0) == FEWEST_FOR_A_MEAN
    assert episodes_needed(means(20, 5.0, 0.0), 0.05) == 6  # signs alone
    assert episodes_needed(means(1, 5.0, 2.0), 0.05) == 6
