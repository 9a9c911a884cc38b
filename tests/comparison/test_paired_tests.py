import numpy as np
import pytest

from minitouch_bench.comparison.paired_tests import paired_test
from minitouch_bench.comparison.pairing import PairedValues


def effect_of(metric, first, second, task="pushing"):
    return paired_test(PairedValues(task, metric, (task,), first, second), (0,))


def has_0(effect):
    return effect.difference.low <= 0 <= effect.difference.high


@pytest.mark.parametrize("n", [5, 6, 9, 30, 100])
def test_an_interval_of_a_share_is_without_0_exactly_where_p_is_small(n):
    for lost in range(n + 1):
        for won in range(0, n - lost + 1, max(1, n // 9)):
            first, second = np.zeros(n), np.zeros(n)
            first[:lost] = 1
            second[lost : lost + won] = 1
            effect = effect_of("success", first, second)
            assert has_0(effect) == (effect.p_value > 0.05), (lost, won)
            assert effect.difference.low <= effect.difference.value <= effect.difference.high


@pytest.mark.parametrize("seed", range(40))
def test_an_interval_of_a_mean_contains_0_where_p_is_large(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 40))
    effect = effect_of("episode_steps", np.zeros(n), rng.gamma(1, 10, n) - rng.uniform(0, 9))
    assert has_0(effect) or effect.p_value <= 0.05
    assert effect.is_clear == (effect.p_value <= 0.05 and not has_0(effect))


def test_the_better_direction_is_that_of_the_task():
    few, many = np.full(20, 100.0), np.linspace(200, 300, 20)
    assert effect_of("touch_interaction", few, many, "playing").worsening < 0
    assert effect_of("episode_steps", few, many).worsening > 0
    with pytest.raises(KeyError):
        _ = effect_of("touch_interaction", few, many).worsening
