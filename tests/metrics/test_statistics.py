"""Each statistic: its estimate, its difference and its paired test against data of known truth."""

import numpy as np
import pytest

from minitouch_bench.metrics.intervals import newcombe, wilson
from minitouch_bench.metrics.significance import mcnemar_p, sign_flip_p
from minitouch_bench.metrics.statistics import MEAN, SHARE, Quantile

TENTH = Quantile(0.9)


def rng(seed=0):
    return np.random.default_rng(seed)


def test_a_share_has_wilson_newcombe_tango_and_mcnemar():
    first, second = np.zeros(20), np.zeros(20)
    first[:12] = 1
    second[10:15] = 1
    assert SHARE.estimate(first.tolist(), rng()) == wilson(12, 20)
    assert SHARE.difference(first, second, rng()) == newcombe(wilson(12, 20), wilson(5, 20))
    found = SHARE.paired_test(first, second, rng())
    assert (found.estimate.method, found.estimate.value) == ("tango", pytest.approx(-0.35))
    assert found.p_value == mcnemar_p(10, 3)


def test_a_mean_has_the_bootstrap_and_flips_of_signs():
    first, second = rng(1).gamma(2, 30, 80), rng(2).gamma(2, 40, 80)
    found = MEAN.paired_test(first, second, rng(5))
    assert found == MEAN.paired_test(first, second, rng(5))
    assert found.estimate.value == pytest.approx((second - first).mean())
    assert found.p_value == pytest.approx(sign_flip_p(second - first, rng(6)), abs=0.02)
    assert MEAN.difference(first, second, rng()).value == pytest.approx((first - second).mean())


def test_a_quantile_is_an_observed_value_between_order_statistics():
    values = rng(1).permutation(np.arange(1.0, 101.0))
    found = TENTH.estimate(values.tolist(), rng())
    assert (found.value, found.low, found.high, found.count) == (90, 84, 96, 100)
    few = TENTH.estimate([1.0, 2.0, 3.0], rng())
    assert few.low == 1
    assert few.high == few.value == 3


def test_quantiles_of_equal_policies_do_not_differ():
    values = rng(1).gamma(2, 30, 50)
    found = TENTH.paired_test(values, values, rng())
    assert (found.p_value, found.estimate.value, found.estimate.low, found.estimate.high) == (
        1,
        0,
        0,
        0,
    )


def test_a_longer_tail_is_found_by_a_quantile_and_not_by_the_mean():
    first = rng(1).normal(100, 1, 100)
    second = first.copy()
    second[:20] += 50
    second[20:] -= 12.5
    assert TENTH.paired_test(first, second, rng()).p_value < 0.01
    assert MEAN.paired_test(first, second, rng()).p_value > 0.5
    apart = TENTH.difference(second, first, rng())
    assert 0 < apart.low <= apart.value <= apart.high


def test_the_interval_of_a_quantile_and_its_test_hold_their_level():
    generator = rng(3)
    truth = 2.302585  # of the exponential distribution
    covered = [
        found.low <= truth <= found.high
        for found in (TENTH.estimate(generator.exponential(1, 100), generator) for _ in range(500))
    ]
    assert 0.92 <= np.mean(covered) <= 0.99
    hard = generator.gamma(2, 1, (100, 60))
    pairs = [(row + generator.gamma(1, 1, 60), row + generator.gamma(1, 1, 60)) for row in hard]
    p_values = [TENTH.paired_test(*pair, generator).p_value for pair in pairs]
    assert np.mean(np.array(p_values) <= 0.05) <= 0.12
