import numpy as np
import pytest

from minitouch_bench.metrics import bootstrap_mean
from minitouch_bench.metrics.intervals import RESAMPLES
from minitouch_bench.metrics.shared_bootstrap import (
    mean_intervals,
    resample_weights,
    stratified_intervals,
)

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


def test_marked_values_alone_are_counted():
    table = np.concatenate([np.full(50, 3.0), np.full(50, 1e9)])[None]
    mask = table < 10
    assert mean_intervals(table, resample_weights(100, ROOT, "a"), mask)[0] == pytest.approx(3.0)


def test_a_sample_without_a_marked_value_has_no_interval():
    table, mask = np.ones((2, 100)), np.zeros((2, 100), bool)
    mask[1, 3] = True
    limits = mean_intervals(table, resample_weights(100, ROOT, "a"), mask)
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
