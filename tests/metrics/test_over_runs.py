import numpy as np
import pytest

from minitouch_bench.metrics import wilson
from minitouch_bench.metrics.over_runs import (
    interquartile_mean,
    performance_profile,
    resample_scores,
)

RATES = ((0.9, 0.8, 0.2), (0.5, 0.6, 0.55), (0.1, 0.3, 0.7))


def scores(rates=RATES, episodes=100, seed=0):
    by_task = [[wilson(round(rate * episodes), episodes) for rate in own] for own in rates]
    return resample_scores(by_task, np.random.default_rng(seed))


def test_the_interquartile_mean_is_that_of_the_middle_half():
    found = interquartile_mean(scores())
    middle = sorted(rate for own in RATES for rate in own)[2:-2]
    assert found.value == pytest.approx(np.mean(middle))
    assert found.low < found.value < found.high
    assert found.count == 9
    assert "training seeds" in found.method


def test_the_same_generator_gives_the_same_numbers():
    one_run = [own[:1] for own in RATES]
    first, again, other = (interquartile_mean(scores(one_run, seed=seed)) for seed in (3, 3, 4))
    assert first == again
    assert first != other


@pytest.mark.parametrize("rates", [((0.0,), (0.0,)), ((1.0, 1.0), (1.0, 1.0))])
def test_no_interval_has_a_width_of_0(rates):
    found = interquartile_mean(scores(rates, episodes=20))
    assert 0.01 < found.high - found.low < 0.3
    assert found.low <= found.value <= found.high


def test_the_interval_of_one_run_covers_its_mean_success_in_95_of_100_cases():
    truth, rng = np.array([0.2, 0.5, 0.8]), np.random.default_rng(1)
    hits = 0
    for _ in range(100):
        runs = [[wilson(int(rng.binomial(50, rate)), 50)] for rate in truth]
        found = interquartile_mean(resample_scores(runs, rng))
        hits += found.low <= truth.mean() <= found.high
    assert hits >= 89


def test_the_profile_falls_from_all_to_none_inside_its_interval():
    thresholds = np.linspace(0, 1, 21)
    share, low, high = performance_profile(scores(), thresholds)
    assert share[0] == 1
    assert share[-1] == 0
    assert share[10] == pytest.approx(5 / 9)  # above 0.5
    assert (np.diff(share) <= 0).all()
    assert (low <= share).all()
    assert (share <= high).all()
