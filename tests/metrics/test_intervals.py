import numpy as np
import pytest

from minitouch_bench.metrics.intervals import bootstrap_mean, wilson


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
