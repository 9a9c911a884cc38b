import math

import numpy as np
import pytest
from scipy import stats

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.intervals import (
    Estimate,
    bootstrap,
    newcombe,
    over_seeds,
    quadrature,
    student_mean,
    wilson,
)


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        (97, 100, 0.9155, 0.9897),
        (0, 100, 0.0, 0.0370),
        (100, 100, 0.9630, 1.0),
        (1, 2, 0.095, 0.905),
    ],
)
def test_wilson_gives_the_published_values(successes, n, low, high):
    estimate = wilson(successes, n)
    assert estimate.value == successes / n
    assert estimate.low == pytest.approx(low, abs=5e-4)
    assert estimate.high == pytest.approx(high, abs=5e-4)
    assert (estimate.count, estimate.method) == (n, "wilson")


@pytest.mark.parametrize(
    ("draw", "truth"),
    [
        (lambda rng: [rng.poisson(3, 100)], 3),
        (lambda rng: [rng.normal(5, 2, 100), rng.poisson(3, 80)], 2),
    ],
)
def test_bootstrap_covers_the_truth_95_percent_of_the_time(draw, truth):
    rng = np.random.default_rng(7)
    found = [bootstrap(draw(rng), rng, resamples=400) for _ in range(800)]
    assert 0.93 <= np.mean([e.low <= truth <= e.high for e in found]) <= 0.97


def steps(rng, success):
    """Control steps of 100 episodes, the failures at the limit."""
    won = rng.random(100) < success
    return np.where(won, np.clip(rng.gamma(5, 6, 100), 5, 200), 200.0)


def touch(rng, touched):
    """Ticks of contact, none in some episodes."""
    return np.where(rng.random(100) < touched, rng.gamma(2, 100, 100), 0.0)


def rare(rng, share, signs):
    """Differences of paired episodes, most of which are alike."""
    sizes = rng.choice(signs, 100) * rng.gamma(2, 30, 100)
    return np.where(rng.random(100) < share, sizes, 0.0)


SKEWED = {
    "steps, 95 % succeed": (lambda rng: steps(rng, 0.95), None, 0.93),
    "touch in 30 %": (lambda rng: touch(rng, 0.3), 60.0, 0.93),
    "touch, heavy tails": (lambda rng: np.exp(rng.normal(5, 0.6, 100)), np.exp(5.18), 0.93),
    "paired, skewed": (lambda rng: rng.gamma(0.5, 40, 100) - 20, 0.0, 0.89),
    "paired steps": (lambda rng: steps(rng, 0.7) - steps(rng, 0.8), None, 0.89),
    "a tenth differ, one way": (lambda rng: rare(rng, 0.1, [1]), 6.0, 0.89),
    "a fifth differ, both ways": (lambda rng: rare(rng, 0.2, [-1, 1]), 0.0, 0.89),
}


@pytest.mark.slow
@pytest.mark.parametrize("draw", SKEWED)
def test_bootstrap_covers_the_truth_of_skewed_episodes(draw):
    make, truth, least = SKEWED[draw]
    rng = np.random.default_rng(7)
    if truth is None:
        truth = np.mean([make(rng).mean() for _ in range(40_000)])
    estimates = [bootstrap([make(rng)], rng, resamples=1000) for _ in range(2000)]
    covered = np.mean([e.low <= truth <= e.high for e in estimates])
    assert least <= covered <= 0.97


def test_bootstrap_repeats_with_the_seed_and_stays_inside_the_values():
    values = np.random.default_rng(1).gamma(2, 30, 80)
    first = bootstrap([values], np.random.default_rng(5))
    assert first == bootstrap([values], np.random.default_rng(5))
    assert first != bootstrap([values], np.random.default_rng(6))
    assert first.low < first.value < first.high
    assert (first.count, first.method) == (80, "bootstrap")
    assert bootstrap([[0, 0, 0, 90]], np.random.default_rng(0)).low >= 0


def test_newcombe_gives_the_published_values():
    # Newcombe 1998, Table II, method 10: 56/70 - 48/80, 9/10 - 3/10, 5/56 - 0/29.
    for first, second, low, high in (
        ((56, 70), (48, 80), 0.0524, 0.3339),
        ((9, 10), (3, 10), 0.1705, 0.8090),
        ((5, 56), (0, 29), -0.0381, 0.1926),
    ):
        found = newcombe(wilson(*first), wilson(*second))
        assert found.low == pytest.approx(low, abs=5e-5)
        assert found.high == pytest.approx(high, abs=5e-5)
        assert (found.count, found.method) == (first[1] + second[1], "newcombe")


@pytest.mark.parametrize("n", [1, 10, 200])
def test_newcombe_has_a_width_and_stays_in_minus_1_to_1(n):
    shares = [wilson(successes, n) for successes in range(0, n + 1, max(1, n // 10))]
    for first in shares:
        for second in shares:
            found = newcombe(first, second)
            assert -1 <= found.low <= found.value <= found.high <= 1
            assert found.high - found.low > 0
            turned = newcombe(second, first)
            assert (turned.low, turned.high) == pytest.approx((-found.high, -found.low))


@pytest.mark.parametrize(
    ("held_out", "train"), [(0.5, 0.5), (0.7, 0.8), (0.9, 0.9), (0.85, 0.95), (0.3, 0.6)]
)
def test_newcombe_covers_the_truth_95_percent_of_the_time(held_out, train):
    rng, n = np.random.default_rng(0), 200
    pairs = zip(rng.binomial(n, held_out, 4000), rng.binomial(n, train, 4000), strict=True)
    found = [newcombe(wilson(int(one), n), wilson(int(other), n)) for one, other in pairs]
    covered = [estimate.low <= held_out - train <= estimate.high for estimate in found]
    assert 0.93 <= np.mean(covered) <= 0.97


def test_bootstrap_of_equal_values_has_no_width():
    alone = bootstrap([[0.1] * 7], np.random.default_rng(0))
    assert (alone.low, alone.value, alone.high) == (0.1, 0.1, 0.1)
    found = bootstrap(([0.1] * 7, [0.1] * 3), np.random.default_rng(0))
    assert (found.low, found.value, found.high) == (0, 0, 0)
    one = bootstrap(([0.1] * 7, [0.1, 0.3]), np.random.default_rng(0))
    assert one.low < one.high


UNIT = (0.0, 1.0)


def test_seeds_have_student_s_interval_and_a_share_is_no_narrower_than_over_all_episodes():
    equal = over_seeds([wilson(50, 100)] * 3, UNIT)
    pooled = wilson(150, 300)
    assert (equal.value, equal.count) == (0.5, 3)
    assert (equal.low, equal.high) == pytest.approx((pooled.low, pooled.high))
    apart = [wilson(30, 100), wilson(50, 100), wilson(55, 100)]
    interval = stats.ttest_1samp([0.3, 0.5, 0.55], 0).confidence_interval(0.95)
    found = over_seeds(apart, UNIT)
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high))


def test_an_interval_over_seeds_stays_in_the_possible_range():
    wide = over_seeds([wilson(10, 100), wilson(50, 100), wilson(90, 100)], UNIT)
    assert (wide.low, wide.high) == UNIT
    steps = METRICS["episode_steps"].range_in("pushing")
    assert student_mean([20.0, 200.0, 190.0], steps).high == 200
    gap = METRICS["success"].range_in("pushing", difference=True)
    assert student_mean([-0.9, 0.9, -0.9], gap).low == -1


def seeds_that_fail(share, covered):
    """Each training seed succeeds in 0.9 of the episodes, or fails and succeeds in 0.05."""
    return (lambda rng: np.where(rng.random(5) < share, 0.05, 0.9)), 0.9 - 0.85 * share, covered


SEEDS = {
    "vary by 0.05": ((lambda rng: rng.normal(0.68, 0.05, 5)), 0.68, 0.96),
    "vary by 0.15": ((lambda rng: rng.normal(0.5, 0.15, 5)), 0.5, 0.95),
    "a tenth fail": seeds_that_fail(0.1, 0.42),
    "a fifth fail": seeds_that_fail(0.2, 0.67),
    "half fail": seeds_that_fail(0.5, 0.94),
}


@pytest.mark.slow
@pytest.mark.parametrize("draw", SEEDS)
def test_five_seeds_cover_the_truth_as_the_documentation_says(draw):
    """Where a tenth fails, five seeds without a failure do not show that there are any."""
    make, truth, measured = SEEDS[draw]
    rng = np.random.default_rng(7)
    drawn = [rng.binomial(100, np.clip(make(rng), 0, 1)) for _ in range(2000)]
    found = [over_seeds([wilson(int(won), 100) for won in seeds], UNIT) for seeds in drawn]
    covered = np.mean([one.low <= truth <= one.high for one in found])
    print(f"{draw}: {covered:.3f}")
    assert covered == pytest.approx(measured, abs=0.02)


def test_means_over_seeds_are_no_narrower_than_over_all_episodes():
    rng = np.random.default_rng(0)
    one = bootstrap([rng.normal(3, 1, 50)], rng)
    equal, episodes = over_seeds([one] * 2, (0.0, math.inf)), quadrature([one] * 2)
    assert (equal.low, equal.high) == (episodes.low, episodes.high)
    assert episodes.value == pytest.approx(one.value)
    assert episodes.high - episodes.low == pytest.approx((one.high - one.low) / 2**0.5)


def test_sums_are_the_same_on_every_python():
    """``sum`` compensates rounding since Python 3.12."""
    assert quadrature([Estimate(0.1, 0.0, 0.2, 1, "wilson")] * 10).value == 0.1
    assert student_mean([0.1] * 10, UNIT).value == 0.1
