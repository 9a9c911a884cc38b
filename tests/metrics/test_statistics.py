"""Each statistic: its estimate, its difference and its paired test against data of known truth."""

import numpy as np
import pytest
from scipy import stats

from minitouch_bench.metrics.intervals import NORMAL_QUANTILE
from minitouch_bench.metrics.statistics import (
    MEAN,
    holm,
    mcnemar_p,
    score_statistic,
    sign_flip_p,
    tango,
)


def rng(seed=0):
    return np.random.default_rng(seed)


def test_a_mean_has_the_bootstrap_and_flips_of_signs():
    first, second = rng(1).gamma(2, 30, 80), rng(2).gamma(2, 40, 80)
    found = MEAN.paired_test(first, second, rng(5))
    assert found == MEAN.paired_test(first, second, rng(5))
    assert found.estimate.value == pytest.approx((second - first).mean())
    assert found.p_value == pytest.approx(sign_flip_p(second - first, rng(6)), abs=0.02)
    assert MEAN.difference(first, second, rng()).value == pytest.approx((first - second).mean())


def paired_mean(differences, generator):
    return MEAN.paired_test(np.zeros(len(differences)), differences, generator)


@pytest.mark.parametrize("n", [2, 5, 100])
def test_one_difference_alone_proves_nothing_and_has_a_bounded_interval(n):
    values = np.zeros(n)
    values[0] = 150.0
    found = paired_mean(values, rng())
    assert found.p_value == 1.0
    assert -150 <= found.estimate.low <= 0 < found.estimate.high <= 150
    same = paired_mean(np.zeros(n), rng())
    assert (same.estimate.low, same.estimate.value, same.estimate.high) == (0, 0, 0)
    assert same.p_value == 1.0


def test_few_episodes_cannot_be_significant():
    assert paired_mean(np.array([10.0, 12, 9, 11, 10]), rng()).p_value == 2 / 32


def test_signs_are_tried_all_or_drawn_with_the_same_result():
    values = rng(3).normal(0.4, 1, 13)
    exact = sign_flip_p(values, rng())
    drawn = sign_flip_p(np.concatenate((values, [1e-9])), rng(), resamples=20_000)
    assert drawn == pytest.approx(exact, abs=0.012)


def test_mcnemar_is_the_binomial_test_of_scipy():
    lost, won = np.indices((30, 30))
    found = mcnemar_p(lost, won)
    for pair in ((0, 1), (7, 2), (12, 29), (29, 29)):
        assert found[pair] == pytest.approx(stats.binomtest(pair[0], sum(pair)).pvalue)


def test_tango_gives_the_published_values():
    # Fagerland, Lydersen and Laake 2014, Table III: airway reactivity, 7 against 1 of 21.
    found = tango(7, 1, 21)
    assert (round(found.low, 3), round(found.high, 3)) == (-0.517, -0.026)
    # Tango 1998, contact lenses: 90 % interval of 0 against 1 of 44.
    lenses = tango(1, 0, 44, 1.6448536)
    assert (round(lenses.low, 3), round(lenses.high, 3)) == (-0.096, 0.037)
    assert (lenses.value, lenses.count, lenses.method) == (-1 / 44, 44, "tango")


@pytest.mark.parametrize("n", [1, 2, 10, 100])
def test_tango_has_a_width_and_stays_in_minus_1_to_1(n):
    step = max(1, n // 5)
    for lost in range(0, n + 1, step):
        for won in range(0, n - lost + 1, step):
            found = tango(lost, won, n)
            assert -1 <= found.low <= found.value <= found.high <= 1
            assert found.high - found.low > 0
            turned = tango(won, lost, n)
            assert (turned.low, turned.high) == pytest.approx((-found.high, -found.low))


def coverage(n, lost_rate, won_rate):
    """The chance, summed over all outcomes, that the interval holds the truth."""
    total = 0.0
    for lost, chance in enumerate(stats.binom.pmf(np.arange(n + 1), n, lost_rate)):
        won = np.arange(n - lost + 1)
        statistic = [score_statistic(lost, int(one), n, won_rate - lost_rate) for one in won]
        inside = np.abs(statistic) <= NORMAL_QUANTILE
        rest = stats.binom.pmf(won, n - lost, won_rate / (1 - lost_rate))
        total += chance * rest[inside].sum()
    return total


RATES = [(0.02, 0.02), (0.05, 0.05), (0.1, 0.05), (0.1, 0.1), (0.2, 0.1), (0.3, 0.05), (0.4, 0.02)]


@pytest.mark.parametrize("rates", RATES)
@pytest.mark.parametrize("n", [100, 200])
def test_tango_covers_the_truth_95_percent_of_the_time(n, rates):
    assert 0.93 <= coverage(n, *rates) <= 0.97


def test_holm_gives_the_textbook_s_values():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx((0.03, 0.06, 0.06, 0.02))
    assert holm([0.6, 0.7]) == (1.0, 1.0)
    assert holm([]) == ()
