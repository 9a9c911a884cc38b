import math
from itertools import combinations

import numpy as np
import pytest
from scipy import stats

from benchmarks.board_errors import SETTINGS, simulate
from minitouch_bench.leaderboard.ranking import judge_pairs, rank, ranks_of
from minitouch_bench.metrics.intervals import MeanDifferences, mean_differences
from minitouch_bench.metrics.statistics import holm, seeds_to_decide
from minitouch_bench.protocol.minitouch import TASK_NAMES


def mean_p_values(strata):
    return mean_differences(strata).p_values


def single(values):
    return np.asarray(values, float)[None]


def test_a_paired_t_test_by_hand():
    difference = np.array([1.0, 2.0, 0.0, 3.0, -1.0])
    base = np.array([5.0, 1.0, 9.0, 4.0, 2.0])
    t = difference.mean() / (difference.std(ddof=1) / math.sqrt(5))
    assert t == pytest.approx(1.41421356)
    p = mean_p_values([[single(base + difference), single(base)]])[0, 1]
    assert p == pytest.approx(0.2302, abs=1e-4)  # of Student's t, 4 degrees of freedom


def test_the_noise_of_episodes_counts_once():
    """By hand: 2 seeds by 3 episodes of one row, against a row that never varies."""
    row = np.array([[0.0, 1, 5], [2, 3, 1]])
    flat = np.zeros((2, 3))
    over_episodes = np.var([1.0, 2, 3], ddof=1) / 3
    over_seeds = np.var([2.0, 2], ddof=1) / 2
    assert (over_episodes, over_seeds) == (1 / 3, 0)  # less the residual, still 0
    t = 2 / math.sqrt(over_episodes)
    assert mean_p_values([[row, flat]])[0, 1] == pytest.approx(2 * stats.t.sf(t, 2))
    apart = np.array([[0.0, 1, 5], [11, 12, 10]])
    over_seeds = np.var([2.0, 11], ddof=1) / 2
    residuals = np.array([[-1.0, -1, 2], [1, 1, -2]])
    residual = (residuals**2).sum() / 2 / 6
    variance = over_episodes + over_seeds - residual
    freedom = variance**2 / (over_episodes**2 / 2 + over_seeds**2 / 1)
    expected = 2 * stats.t.sf(6.5 / math.sqrt(variance), freedom)
    found = mean_p_values([[apart, flat]])
    assert (found[0, 1], found[1, 0]) == pytest.approx((expected, expected))


def test_a_copy_of_a_row_differs_by_nothing_whatever_the_order_of_its_seeds():
    """Most of these rows' seeds vary no more than single episodes do."""
    rng = np.random.default_rng(0)
    for size in (1, 1e4) * 100:
        row = size * rng.random((3, 50))
        assert mean_p_values([[row, row[[2, 0, 1]]]]).tolist() == [[1, 1], [1, 1]]


def test_false_alarms_over_seeds_stay_near_one_in_twenty():
    """Of boards of four equal methods, for seeds that vary and seeds that do not."""
    methods = SETTINGS["equal variances, 5 seeds"]
    pair, board, _ = simulate(methods, 300, 0.0)
    assert 0.02 <= pair <= 0.07
    assert board <= 0.085
    pair, board, power = simulate(SETTINGS["seeds do not vary, 5 seeds"], 300, 0.1)
    assert board >= power >= 0.5
    pair, _, _ = simulate(SETTINGS["one seed"], 300, 0.0)
    assert pair <= 0.05  # by McNemar's exact test


@pytest.mark.parametrize("strata", [1, 3])
def test_false_alarms_of_means_are_one_in_twenty(strata):
    """Of 1,000 independent pairs of equal policies."""
    rng = np.random.default_rng(4)
    found = []
    for _ in range(20):
        # Both of a pair meet the same easy and hard episodes.
        ease = rng.random((strata, 100))
        rows = [[single(rng.random(100) < own) for _ in range(100)] for own in ease]
        p = mean_p_values(rows)
        found += [p[place, place + 1] <= 0.05 for place in range(0, 100, 2)]
    assert 0.03 <= np.mean(found) <= 0.07


# Ranks


@pytest.mark.parametrize(
    ("means", "differ", "wanted"),
    [
        ((0.9, 0.85, 0.3, 0.25), ("02", "03", "12", "13"), [(1, 2), (1, 2), (3, 4), (3, 4)]),
        ((0.9, 0.7, 0.5), ("02",), [(1, 2), (1, 3), (2, 3)]),
        ((0.9, 0.7, 0.5), ("01", "12"), [(1, 1), (2, 2), (3, 3)]),  # and so the first two differ
    ],
)
def test_rows_that_cannot_be_told_apart_share_a_rank(means, differ, wanted):
    p = np.ones((len(means), len(means)))
    for one, other in (map(int, pair) for pair in differ):
        p[one, other] = p[other, one] = 1e-6
    ranks = ranks_of(judge_pairs(np.array(means), p)[1])
    assert [(rank.best, rank.worst) for rank in ranks] == wanted


def random_tables(number):
    rng = np.random.default_rng(5)
    for _ in range(number):
        rows = int(rng.integers(2, 9))
        upper = np.triu(rng.random((rows, rows)) ** 6, 1)
        yield rng.random(rows), upper + upper.T + np.eye(rows)


def test_no_rank_contradicts_another():
    """Each finding counts for both of its rows, and the better row has the smaller rank."""
    found = 0
    for means, p_values in random_tables(300):
        ranks = ranks_of(judge_pairs(means, p_values)[1])
        better = sum(rank.best - 1 for rank in ranks)
        assert better == sum(len(means) - rank.worst for rank in ranks)
        pairs = np.triu_indices(len(means), 1)
        adjusted = np.ones_like(p_values)
        adjusted[pairs] = holm(p_values[pairs])
        for one, other in np.argwhere(adjusted <= 0.05):
            first, second = (one, other) if means[one] > means[other] else (other, one)
            assert ranks[first].best < ranks[second].best
            assert ranks[first].worst < ranks[second].worst
            found += 1
    assert found > 300


# Pairs, and seeds that would settle them


def table_of(rng, seeds, means, deviation=0.1):
    """Return rows of a task whose seeds vary normally around a mean, on the same episodes."""
    ease = rng.random(100)
    own = [rng.normal(mean, deviation, (seeds, 1)) for mean in means]
    return [((rng.random((seeds, 100)) + ease) / 2 < success).astype(float) for success in own]


def decide(rows, level=0.05):
    return seeds_to_decide(mean_differences([rows]), tuple(map(len, rows)), level)


def test_so_many_seeds_find_the_difference_in_four_of_five_repetitions():
    rng = np.random.default_rng(0)
    many = table_of(rng, 400, (0.6, 0.5))
    needed = decide(many, 0.05 / 3)
    assert 15 < needed < 50
    true = many[0].mean() - many[1].mean()
    half = seeds_to_decide(mean_differences([many]), (400, 400), 0.05 / 3, true / 2)
    assert 3 * needed < half < 6 * needed
    found = [mean_p_values([table_of(rng, needed, (0.6, 0.5))])[0, 1] for _ in range(400)]
    assert 0.7 < np.mean(np.array(found) <= 0.05 / 3) < 0.9
    # Few seeds that happen to show the true difference give about the same number.
    tables = [table_of(rng, 6, (0.6, 0.5)) for _ in range(100)]
    lucky = [rows for rows in tables if abs(rows[0].mean() - rows[1].mean() - true) < 0.02]
    assert needed / 2 < np.median([decide(rows, 0.05 / 3) for rows in lucky]) < needed * 2


def test_a_difference_for_which_scipy_gives_nan_is_found():
    difference, seeds = 0.3, 3
    variance = (difference / 4.0) ** 2
    found = MeanDifferences(
        np.array([[0.0, difference], [-difference, 0.0]]),
        np.full((2, 2), variance), np.zeros((2, 2)), np.full((2, 2), 4.0),
    )  # fmt: skip
    assert seeds_to_decide(found, (seeds, seeds), 0.05 / 6) == 5


def test_no_number_of_seeds_is_made_up():
    rng = np.random.default_rng(2)
    far, near = table_of(rng, 5, (0.8, 0.5))
    assert decide([far, near]) < decide([far, near], 0.001)
    for unknown in ((far[:1], near), (far, near[:1]), (far, far)):
        assert decide(unknown) is None
    assert decide(table_of(rng, 5, (0.5, 0.5001), 0.3), 1e-15) is None


def test_pairs_say_what_the_ranks_rest_on():
    rng = np.random.default_rng(3)
    rows = dict(zip("abc", table_of(rng, 6, (0.9, 0.5, 0.47), 0.03), strict=True))
    rankings = rank({name: dict.fromkeys(TASK_NAMES, row) for name, row in rows.items()})
    for key, ranking in rankings.items():
        assert [(pair.higher, pair.lower) for pair in ranking.pairs] == list(combinations("abc", 2))
        assert [pair.is_significant for pair in ranking.pairs] == [True, True, False], key
        assert [pair.seeds is None for pair in ranking.pairs] == [True, True, False]
        assert [(one.best, one.worst) for one in ranking.ranks.values()] == [(1, 1), (2, 3), (2, 3)]
        assert ranking.pairs[0].p <= 0.05 < ranking.pairs[2].p
    assert rank({}) == {}
