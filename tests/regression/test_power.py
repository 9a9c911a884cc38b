import math

import numpy as np
import pytest

from minitouch_bench.metrics.intervals import bootstrap_mean
from minitouch_bench.metrics.significance import Discordance, mcnemar_p, sign_flip_p, tango
from minitouch_bench.regression.power import (
    EXACT_UP_TO,
    FEWEST_FOR_A_MEAN,
    MeanResolution,
    ShareResolution,
    critical_counts,
    exclusion_power,
    mcnemar_power,
)

TRIALS = 2000
ERROR = 3 * math.sqrt(0.8 * 0.2 / TRIALS)
"""Three standard errors of a share of 0.8 in so many trials."""


@pytest.mark.parametrize("alpha", [0.05, 0.005, 0.0625])
def test_the_critical_count_is_the_least_that_is_significant(alpha):
    found = critical_counts(np.arange(120), alpha)
    for pairs, count in enumerate(found):
        if count <= pairs:
            assert mcnemar_p(pairs - count, count) <= alpha
        if 2 * (count - 1) > pairs:
            assert mcnemar_p(pairs - count + 1, count - 1) > alpha
    assert found[4] == 5  # four of four is no proof


def test_the_power_of_mcnemar_is_the_share_of_significant_draws():
    drawn = np.random.default_rng(0).multinomial(100, (0.2, 0.06, 0.74), TRIALS)
    seen = np.mean([lost > won and mcnemar_p(lost, won) <= 0.05 for lost, won, _ in drawn])
    assert mcnemar_power(100, 0.2, 0.06, 0.05) == pytest.approx(seen, abs=ERROR)


def test_the_power_of_exclusion_is_the_share_of_intervals_that_exclude():
    drawn = np.random.default_rng(0).multinomial(150, (0.03, 0.03, 0.94), TRIALS)
    known = {(lost, won): tango(Discordance(150, lost, won)).low for lost, won, _ in drawn.tolist()}
    seen = np.mean([known[lost, won] > -0.06 for lost, won, _ in drawn.tolist()])
    assert exclusion_power(150, 0.03, 0.03, 0.06) == pytest.approx(seen, abs=ERROR)


@pytest.mark.parametrize("found", [Discordance(100, 20, 8), Discordance(50, 4, 0)])
@pytest.mark.parametrize("alpha", [0.05, 0.005])
def test_the_episodes_printed_for_a_share_have_the_power_promised(found, alpha):
    resolution = ShareResolution(found)
    n = resolution.episodes_to_detect(alpha)
    rates = (found.lost / found.n, found.won / found.n)
    assert mcnemar_power(n, *rates, alpha) >= 0.8 > mcnemar_power(n - 2, *rates, alpha)
    drawn = np.random.default_rng(1).multinomial(n, (*rates, 1 - sum(rates)), TRIALS)
    seen = np.mean([mcnemar_p(int(lost), int(won)) <= alpha for lost, won, _ in drawn])
    assert 0.8 - ERROR <= seen <= 0.86


def test_the_episodes_printed_to_exclude_a_loss_have_the_power_promised():
    n = ShareResolution(Discordance(100, 4, 4)).episodes_to_exclude(0.05)
    assert exclusion_power(n, 0.04, 0.04, 0.05) >= 0.8 > exclusion_power(n - 6, 0.04, 0.04, 0.05)


def test_where_no_pair_differs_the_rule_of_three_tells_the_episodes():
    assert ShareResolution(Discordance(10, 0, 0)).episodes_to_exclude(0.05) == 73
    assert tango(Discordance(73, 0, 0)).low >= -0.05 > tango(Discordance(72, 0, 0)).low
    assert ShareResolution(Discordance(10, 0, 0)).episodes_to_detect(0.05) is None


def test_many_episodes_are_counted_by_formula_in_line_with_the_sum():
    large = ShareResolution(Discordance(1000, 120, 100)).episodes_to_detect(0.05)
    assert large > EXACT_UP_TO
    assert mcnemar_power(large, 0.12, 0.1, 0.05) == pytest.approx(0.8, abs=0.02)
    excluded = ShareResolution(Discordance(1000, 220, 200)).episodes_to_exclude(0.05)
    assert excluded > EXACT_UP_TO
    assert exclusion_power(excluded, 0.22, 0.2, 0.05) == pytest.approx(0.8, abs=0.02)


@pytest.mark.parametrize("found", [Discordance(100, 10, 5), Discordance(60, 0, 0)])
def test_a_detectable_share_is_seen_by_the_present_episodes(found):
    smallest = ShareResolution(found).detectable(0.05)
    differing = max(smallest, (found.lost + found.won) / found.n)
    rates = ((differing + smallest) / 2, (differing - smallest) / 2)
    assert mcnemar_power(found.n, *rates, 0.05) == pytest.approx(0.8, abs=0.02)


def test_five_episodes_detect_no_share():
    assert ShareResolution(Discordance(5, 5, 0)).detectable(0.05) is None


@pytest.mark.parametrize("worsening", [4.0, -9.0])
def test_the_episodes_printed_for_a_mean_have_the_power_promised(worsening):
    n = MeanResolution(100, worsening, 14.0).episodes_to_detect(0.05)
    rng = np.random.default_rng(2)
    trials = 600
    seen = np.mean(
        [sign_flip_p(rng.normal(worsening, 14, n), rng, 1000) <= 0.05 for _ in range(trials)]
    )
    assert abs(seen - 0.8) <= 3 * math.sqrt(0.16 / trials) + 0.02


def test_the_episodes_of_a_mean_and_what_they_detect_fit_together():
    smallest = MeanResolution(80, 1.0, 14.0).detectable(0.05)
    assert MeanResolution(5, smallest, 14.0).episodes_to_detect(0.05) in (80, 81)


def test_means_that_need_no_or_endless_episodes():
    assert MeanResolution(20, 0.0, 3.0).episodes_to_detect(0.05) is None
    assert MeanResolution(20, 1e-9, 3.0).episodes_to_detect(0.05) is None
    assert MeanResolution(20, 2.0, 3.0).episodes_to_exclude(2.0) is None
    assert MeanResolution(20, 0.0, 0.0).episodes_to_exclude(1.0) == FEWEST_FOR_A_MEAN
    assert MeanResolution(20, 5.0, 0.0).episodes_to_detect(0.05) == 6  # signs alone
    assert MeanResolution(20, 5.0, 0.0).detectable(0.05) is None
    assert MeanResolution(1, 5.0, 2.0).detectable(0.05) is None


def test_the_episodes_printed_to_exclude_a_worsening_have_the_power_promised():
    n = MeanResolution(100, 1.0, 14.0).episodes_to_exclude(5.0)
    rng, trials = np.random.default_rng(2), 600
    ends = [bootstrap_mean(rng.normal(1.0, 14, n), rng, 1000).high for _ in range(trials)]
    assert abs(np.mean([end < 5.0 for end in ends]) - 0.8) <= 3 * math.sqrt(0.16 / trials) + 0.02
