import numpy as np
import pytest
from scipy import stats

from minitouch_bench.metrics.intervals import NORMAL_QUANTILE
from minitouch_bench.metrics.significance import (
    Discordance,
    count_discordance,
    holm,
    mcnemar_p,
    score_statistic,
    tango,
)


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


def test_mcnemar_is_the_binomial_test_of_scipy():
    lost, won = np.indices((30, 30))
    found = mcnemar_p(lost, won)
    for pair in ((0, 1), (7, 2), (12, 29), (29, 29)):
        assert found[pair] == pytest.approx(stats.binomtest(pair[0], sum(pair)).pvalue)


def test_tango_gives_the_published_values():
    # Fagerland, Lydersen and Laake 2014, Table III: airway reactivity, 7 against 1 of 21.
    found = tango(Discordance(21, lost=7, won=1))
    assert (round(found.low, 3), round(found.high, 3)) == (-0.517, -0.026)
    # Tango 1998, contact lenses: 90 % interval of 0 against 1 of 44.
    lenses = tango(Discordance(44, lost=1, won=0), quantile=1.6448536)
    assert (round(lenses.low, 3), round(lenses.high, 3)) == (-0.096, 0.037)
    assert (lenses.value, lenses.count, lenses.method) == (-1 / 44, 44, "tango")


@pytest.mark.parametrize("n", [1, 2, 10, 100])
def test_tango_has_a_width_and_stays_in_minus_1_to_1(n):
    step = max(1, n // 5)
    for lost in range(0, n + 1, step):
        for won in range(0, n - lost + 1, step):
            found = tango(Discordance(n, lost, won))
            assert -1 <= found.low <= found.value <= found.high <= 1
            assert found.high - found.low > 0
            turned = tango(Discordance(n, won, lost))
            assert (turned.low, turned.high) == pytest.approx((-found.high, -found.low))


def test_where_no_pair_differs_the_width_depends_on_the_episodes():
    z2 = NORMAL_QUANTILE**2
    for n in (10, 100):
        found = tango(Discordance(n, 0, 0))
        assert found.high == pytest.approx(z2 / (n + z2))
        assert found.low == -found.high


def coverage(n, lost_rate, won_rate):
    """The chance, summed over all outcomes, that the interval holds the truth."""
    total = 0.0
    for lost, chance in enumerate(stats.binom.pmf(np.arange(n + 1), n, lost_rate)):
        won = np.arange(n - lost + 1.0)
        statistic = score_statistic(np.full_like(won, lost), won, n, won_rate - lost_rate)
        inside = np.abs(statistic) <= NORMAL_QUANTILE
        rest = stats.binom.pmf(won, n - lost, won_rate / (1 - lost_rate))
        total += chance * rest[inside].sum()
    return total


RATES = [(0.02, 0.02), (0.05, 0.05), (0.1, 0.05), (0.1, 0.1), (0.2, 0.1), (0.3, 0.05), (0.4, 0.02)]


@pytest.mark.parametrize("rates", RATES)
@pytest.mark.parametrize("n", [100, 200])
def test_tango_covers_the_truth_95_percent_of_the_time(n, rates):
    assert 0.93 <= coverage(n, *rates) <= 0.97


def test_the_coverage_that_is_summed_is_that_of_the_interval():
    rng, rates = np.random.default_rng(0), (0.2, 0.1)
    drawn = rng.multinomial(60, (*rates, 0.7), 2000)
    known = {(lost, won): tango(Discordance(60, lost, won)) for lost, won, _ in drawn.tolist()}
    found = [known[lost, won] for lost, won, _ in drawn.tolist()]
    covered = np.mean([one.low <= -0.1 <= one.high for one in found])
    assert covered == pytest.approx(coverage(60, *rates), abs=0.015)


def test_pairs_that_differ_are_counted():
    found = count_discordance(np.array([1, 1, 0, 0, 1.0]), np.array([1, 0, 1, 0, 0.0]))
    assert found == Discordance(5, lost=2, won=1)
    assert found.difference == pytest.approx(-0.2)
    assert found.p_value == 1.0


def test_holm_gives_the_textbook_s_values():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx((0.03, 0.06, 0.06, 0.02))
    assert holm([0.6, 0.7]) == (1.0, 1.0)
    assert holm([]) == ()


def test_holm_keeps_order_and_never_lowers_a_value():
    values = np.random.default_rng(0).random(12) ** 3
    adjusted = np.array(holm(list(values)))
    assert (adjusted >= values).all()
    assert (np.diff(adjusted[np.argsort(values)]) >= 0).all()
