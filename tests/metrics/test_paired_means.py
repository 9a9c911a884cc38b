import numpy as np
import pytest

from minitouch_bench.metrics.intervals import bootstrap_mean
from minitouch_bench.metrics.significance import sign_flip_p
from minitouch_bench.metrics.statistics import MEAN


def rng(seed=0):
    return np.random.default_rng(seed)


def paired_mean(differences, generator):
    return MEAN.paired_test(np.zeros(len(differences)), differences, generator)


def test_it_repeats_with_the_seed_and_holds_the_mean():
    values = rng(1).gamma(2, 30, 80) - 40
    found = paired_mean(values, rng(5))
    assert found == paired_mean(values, rng(5))
    assert found != paired_mean(values, rng(6))
    estimate = found.estimate
    assert estimate.low < estimate.value == values.mean() < estimate.high
    assert (estimate.count, estimate.method) == (80, "bootstrap")


def test_the_mirror_image_has_the_mirrored_interval():
    values = rng(1).gamma(2, 30, 80) - 40
    one, other = paired_mean(values, rng(5)), paired_mean(-values, rng(7))
    assert one.estimate.low == pytest.approx(-other.estimate.high, abs=1.5)
    assert one.p_value == pytest.approx(other.p_value, abs=0.02)


def test_no_difference_anywhere_has_no_width_and_is_no_surprise():
    found = paired_mean(np.zeros(30), rng())
    assert (found.estimate.low, found.estimate.value, found.estimate.high) == (0, 0, 0)
    assert found.p_value == 1.0


def test_nearly_equal_differences_have_a_narrow_interval():
    values = 180.0 + rng(2).normal(0, 2, 30)
    found = paired_mean(values, rng())
    assert 177 < found.estimate.low < found.estimate.high < 183
    assert found.p_value < 0.001
    equal = paired_mean(np.full(30, 180.0), rng())
    assert (equal.estimate.low, equal.estimate.high) == (180.0, 180.0)
    assert equal.p_value < 0.001


@pytest.mark.parametrize("n", [2, 5, 100])
def test_one_difference_alone_proves_nothing_and_has_a_bounded_interval(n):
    values = np.zeros(n)
    values[0] = 150.0
    found = paired_mean(values, rng())
    assert found.p_value == 1.0
    assert -150 <= found.estimate.low <= 0 < found.estimate.high <= 150
    assert np.isfinite([found.estimate.low, found.estimate.high]).all()


def test_few_episodes_cannot_be_significant():
    assert paired_mean(np.array([10.0, 12, 9, 11, 10]), rng()).p_value >= 2 / 32
    assert sign_flip_p(np.array([10.0, 12, 9, 11, 10]), rng()) == 2 / 32


def test_signs_are_tried_all_or_drawn_with_the_same_result():
    values = rng(3).normal(0.4, 1, 13)
    exact = sign_flip_p(values, rng())
    drawn = sign_flip_p(np.concatenate((values, [1e-9])), rng(), resamples=20_000)
    assert drawn == pytest.approx(exact, abs=0.012)


def steps_differences(generator, n):
    ends = [
        np.where(generator.random(n) < share, np.clip(generator.gamma(5, 6, n), 5, 200), 200.0)
        for share in (0.8, 0.7)
    ]
    return ends[1] - ends[0]


def rare(share, *, both_signs):
    def of(generator, n):
        sign = generator.choice([-1, 1], n) if both_signs else 1.0
        return np.where(generator.random(n) < share, sign * generator.gamma(2, 30, n), 0.0)

    return of


SHAPES = {
    "skewed": (lambda g, n: g.gamma(0.5, 40, n) - 20, 0.0),
    "steps with failures": (steps_differences, None),
    "touch, heavy tails": (
        lambda g, n: np.exp(g.normal(5, 0.6, n)) - np.exp(g.normal(5.2, 0.6, n)),
        np.exp(5.18) - np.exp(5.38),
    ),
    "a tenth differ, one way": (rare(0.1, both_signs=False), 6.0),
    "a fifth differ, both ways": (rare(0.2, both_signs=True), 0.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_it_covers_the_truth_95_percent_of_the_time(shape):
    make, truth = SHAPES[shape]
    generator = rng(11)
    if truth is None:
        truth = make(generator, 2_000_000).mean()
    found = [bootstrap_mean(make(generator, 100), generator, 1000) for _ in range(2000)]
    covered = np.mean([one.low <= truth <= one.high for one in found])
    print(f"{shape}: {covered:.3f}")
    assert 0.89 <= covered <= 0.97
