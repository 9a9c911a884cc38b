import numpy as np
import pytest

from minitouch_bench.metrics.intervals import (
    RESAMPLES,
    bootstrap_difference,
    bootstrap_mean,
    mean_intervals,
    newcombe,
    resample_weights,
    stratified_intervals,
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


@pytest.mark.parametrize("n", [1, 2, 5, 100, 10_000])
def test_wilson_has_a_width_and_stays_in_0_to_1(n):
    for successes in range(0, n + 1, max(1, n // 50)):
        estimate = wilson(successes, n)
        assert 0 <= estimate.low <= estimate.value <= estimate.high <= 1
        assert estimate.high - estimate.low > 0


@pytest.mark.parametrize(("successes", "n"), [(0, 0), (-1, 5), (6, 5)])
def test_wilson_refuses_what_is_no_share(successes, n):
    with pytest.raises(ValueError, match="no share"):
        wilson(successes, n)


@pytest.mark.parametrize(("share", "n"), [(0.5, 50), (0.75, 100), (0.891, 100), (0.3, 200)])
def test_wilson_covers_the_truth_95_percent_of_the_time(share, n):
    drawn = np.random.default_rng(0).binomial(n, share, 4000)
    by_count = {int(count): wilson(int(count), n) for count in np.unique(drawn)}
    covered = [by_count[int(count)].low <= share <= by_count[int(count)].high for count in drawn]
    assert 0.93 <= np.mean(covered) <= 0.97


@pytest.mark.parametrize("draw", ["normal", "uniform", "poisson"])
def test_bootstrap_covers_the_truth_95_percent_of_the_time(draw):
    rng = np.random.default_rng(7)
    samples = {
        "normal": lambda: rng.normal(3, 2, 100),
        "uniform": lambda: rng.uniform(0, 6, 100),
        "poisson": lambda: rng.poisson(3, 100).astype(float),
    }[draw]
    estimates = [bootstrap_mean(samples(), rng, resamples=500) for _ in range(800)]
    assert 0.93 <= np.mean([e.low <= 3 <= e.high for e in estimates]) <= 0.97


def steps(rng, success):
    """Control steps of 100 episodes, the failures at the limit."""
    won = rng.random(100) < success
    return np.where(won, np.clip(rng.gamma(5, 6, 100), 5, 200), 200.0)


def touch(rng, touched):
    """Ticks of contact, none in some episodes."""
    return np.where(rng.random(100) < touched, rng.gamma(2, 100, 100), 0.0)


SKEWED = {
    "steps, 80 % succeed": (lambda rng: steps(rng, 0.8), None),
    "steps, 95 % succeed": (lambda rng: steps(rng, 0.95), None),
    "touch in all": (lambda rng: touch(rng, 1.0), 200.0),
    "touch in 30 %": (lambda rng: touch(rng, 0.3), 60.0),
    "touch, heavy tails": (lambda rng: np.exp(rng.normal(5, 0.6, 100)), np.exp(5.18)),
}


@pytest.mark.slow
@pytest.mark.parametrize("draw", SKEWED)
def test_bootstrap_covers_the_truth_of_skewed_episodes(draw):
    make, truth = SKEWED[draw]
    rng = np.random.default_rng(7)
    if truth is None:
        truth = np.mean([make(rng).mean() for _ in range(40_000)])
    estimates = [bootstrap_mean(make(rng), rng, resamples=1000) for _ in range(2000)]
    covered = np.mean([e.low <= truth <= e.high for e in estimates])
    print(f"{draw}: {covered:.3f}")
    assert 0.93 <= covered <= 0.97


def test_bootstrap_follows_the_skew():
    rng = np.random.default_rng(0)
    long_tail = bootstrap_mean(rng.gamma(0.5, 40, 100), rng)
    assert long_tail.high - long_tail.value > 1.1 * (long_tail.value - long_tail.low)


def test_bootstrap_repeats_with_the_seed():
    values = np.random.default_rng(1).gamma(2, 30, 80)
    first = bootstrap_mean(values, np.random.default_rng(5))
    assert first == bootstrap_mean(values, np.random.default_rng(5))
    assert first != bootstrap_mean(values, np.random.default_rng(6))
    assert first.low < first.value < first.high
    assert (first.count, first.method) == (80, "bootstrap")


def test_bootstrap_of_equal_values_has_no_width():
    estimate = bootstrap_mean([0.1] * 7, np.random.default_rng(0))
    assert (estimate.low, estimate.value, estimate.high) == (0.1, 0.1, 0.1)


def test_bootstrap_stays_inside_the_values():
    estimate = bootstrap_mean([0, 0, 0, 90], np.random.default_rng(0))
    assert estimate.low >= 0
    assert estimate.high <= 90


def test_bootstrap_draws_in_blocks_for_a_large_sample(monkeypatch):
    monkeypatch.setattr("minitouch_bench.metrics.intervals.DRAWS_PER_BLOCK", 64)
    values = np.arange(50.0)
    estimate = bootstrap_mean(values, np.random.default_rng(0), resamples=2000)
    assert estimate.low == pytest.approx(20.5, abs=0.6)
    assert estimate.high == pytest.approx(28.5, abs=0.6)


@pytest.mark.parametrize("values", [[], [[1.0, 2.0]]])
def test_bootstrap_refuses_what_is_no_sample(values):
    with pytest.raises(ValueError, match="sample"):
        bootstrap_mean(values, np.random.default_rng(0))


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


def test_newcombe_refuses_what_is_no_share():
    with pytest.raises(ValueError, match="two shares"):
        newcombe(wilson(1, 2), bootstrap_mean([1.0, 2.0], np.random.default_rng(0)))


def test_bootstrap_of_a_difference_covers_the_truth_95_percent_of_the_time():
    rng = np.random.default_rng(7)
    found = [
        bootstrap_difference(rng.normal(5, 2, 100), rng.poisson(3, 80), rng, resamples=400)
        for _ in range(800)
    ]
    assert 0.93 <= np.mean([e.low <= 2 <= e.high for e in found]) <= 0.97


def test_bootstrap_of_a_difference_repeats_and_counts_both():
    first, second = np.arange(30.0), np.arange(20.0)
    found = bootstrap_difference(first, second, np.random.default_rng(5))
    assert found == bootstrap_difference(first, second, np.random.default_rng(5))
    assert (found.value, found.count, found.method) == (5.0, 50, "bootstrap")
    assert found.low < 5 < found.high


def test_bootstrap_of_a_difference_of_equal_values_has_no_width():
    found = bootstrap_difference([0.1] * 7, [0.1] * 3, np.random.default_rng(0))
    assert (found.low, found.value, found.high) == (0, 0, 0)
    one = bootstrap_difference([0.1] * 7, [0.1, 0.3], np.random.default_rng(0))
    assert one.low < one.high


def test_bootstrap_of_a_difference_refuses_an_empty_sample():
    with pytest.raises(ValueError, match="sample"):
        bootstrap_difference([1.0], [], np.random.default_rng(0))


ROOT = (0,)


@pytest.fixture(scope="module")
def values():
    return np.random.default_rng(5).gamma(2, 30, (150, 100))


def test_each_resample_draws_as_many_values_as_there_are():
    weights = resample_weights(100, ROOT, "a")
    assert weights.shape == (RESAMPLES, 100)
    assert (weights.sum(axis=1) == 100).all()
    assert weights.mean() == pytest.approx(1)
    assert weights.var() == pytest.approx(0.99, abs=0.01)  # of a multinomial count


def test_streams_have_names_and_repeat():
    again = resample_weights.__wrapped__(30, ROOT, "a")
    assert np.array_equal(resample_weights(30, ROOT, "a"), again)
    assert not np.array_equal(again, resample_weights(30, ROOT, "b"))


def test_intervals_are_those_of_the_plain_bootstrap(values):
    limits = mean_intervals(values, resample_weights(100, ROOT, "a"))
    for own, (low, high) in zip(values[:20], limits, strict=False):
        plain = bootstrap_mean(own, np.random.default_rng(1))
        width = plain.high - plain.low
        assert low == pytest.approx(plain.low, abs=0.06 * width)
        assert high == pytest.approx(plain.high, abs=0.06 * width)


def test_an_interval_does_not_depend_on_the_other_rows(values):
    weights = resample_weights(100, ROOT, "a")
    alone = mean_intervals(values[77:78], weights)
    assert mean_intervals(values, weights)[77].tolist() == alone[0].tolist()


def test_equal_values_have_no_width():
    table = np.full((2, 100), 0.1)
    assert mean_intervals(table, resample_weights(100, ROOT, "a")).tolist() == [[0.1, 0.1]] * 2


def test_an_episode_without_a_value_does_not_count(values):
    weights = resample_weights(100, ROOT, "a")
    table = np.concatenate([np.full(50, 3.0), np.full(50, np.nan)])[None]
    assert mean_intervals(table, weights)[0] == pytest.approx(3.0)
    rows = np.concatenate([table, values[:5]])
    assert (
        mean_intervals(rows, weights)[1:].tolist() == mean_intervals(values[:5], weights).tolist()
    )


def test_a_sample_without_a_value_has_no_interval():
    table = np.full((2, 100), np.nan)
    table[1, 3] = 1.0
    limits = mean_intervals(table, resample_weights(100, ROOT, "a"))
    assert np.isnan(limits[0]).all()
    assert limits[1].tolist() == [1.0, 1.0]


@pytest.mark.parametrize("draw", ["normal", "exponential"])
def test_the_interval_covers_the_truth(draw):
    rng = np.random.default_rng(8)
    table = rng.normal(0, 1, (4000, 100)) if draw == "normal" else rng.exponential(1, (4000, 100))
    truth = 0.0 if draw == "normal" else 1.0
    limits = mean_intervals(table, resample_weights(100, ROOT, "coverage"))
    covered = ((limits[:, 0] <= truth) & (truth <= limits[:, 1])).mean()
    assert 0.93 <= covered <= 0.97


def test_strata_are_resampled_apart():
    rng = np.random.default_rng(2)
    strata = [rng.normal(0, 1, (1, 100)) for _ in range(3)]
    weights = [resample_weights(100, ROOT, name) for name in "abc"]
    (limits,) = stratified_intervals(strata, weights)
    width = limits[1] - limits[0]
    # The error of a mean over three independent strata: sqrt of the sum of variances, over 3.
    error = np.sqrt(sum(stratum.var() / 100 for stratum in strata)) / 3
    assert width == pytest.approx(2 * 1.96 * error, rel=0.05)
