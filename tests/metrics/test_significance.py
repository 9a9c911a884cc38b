import numpy as np
import pytest

from minitouch_bench.metrics.significance import holm


def test_holm_gives_the_textbook_s_values():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx((0.03, 0.06, 0.06, 0.02))
    assert holm([0.6, 0.7]) == (1.0, 1.0)
    assert holm([]) == ()


def test_holm_keeps_order_and_never_lowers_a_value():
    values = np.random.default_rng(0).random(12) ** 3
    adjusted = np.array(holm(list(values)))
    assert (adjusted >= values).all()
    assert (np.diff(adjusted[np.argsort(values)]) >= 0).all()
