import math

import numpy as np
import pytest

from minitouch_bench.regression.binomial import binomial_pmf, critical_count, mcnemar_p


@pytest.mark.parametrize(
    ("n", "share"), [(0, 0.5), (1, 0.3), (12, 0.5), (40, 0.07), (9, 0), (9, 1)]
)
def test_the_distribution_is_the_textbook_s(n, share):
    wanted = [math.comb(n, k) * share**k * (1 - share) ** (n - k) for k in range(n + 1)]
    np.testing.assert_allclose(binomial_pmf(n, share), wanted, rtol=1e-12)


def test_the_distribution_of_many_draws_sums_to_one():
    assert binomial_pmf(5000, 0.01).sum() == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("lost", "won", "p_value"),
    [
        (0, 0, 1.0),
        (3, 3, 1.0),
        (5, 0, 2 / 32),
        (0, 6, 2 / 64),
        (1, 5, 14 / 64),
        (2, 10, 158 / 4096),
    ],
)
def test_mcnemar_counts_the_tails_of_a_fair_coin(lost, won, p_value):
    assert mcnemar_p(lost, won) == pytest.approx(p_value)
    assert mcnemar_p(won, lost) == mcnemar_p(lost, won)


@pytest.mark.parametrize("alpha", [0.05, 0.005])
def test_the_critical_count_is_the_least_that_is_significant(alpha):
    for pairs in range(120):
        count = critical_count(pairs, alpha)
        if count <= pairs:
            assert mcnemar_p(pairs - count, count) <= alpha
        if 2 * (count - 1) > pairs:
            assert mcnemar_p(pairs - count + 1, count - 1) > alpha
    assert critical_count(4, 0.05) == 5  # four of four is no proof
