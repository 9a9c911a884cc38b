import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.shapegen.body_codec import decode, encode, quantized
from tests.shapegen.bodies import box_body


def test_stored_coordinates_are_exact_in_the_text():
    values = quantized(np.random.default_rng(0).uniform(-0.06, 0.06, size=(1000, 3)))
    assert all(float(f"{value:.6f}") == value for value in values.ravel().tolist())
    assert not np.signbit(quantized(np.full((1, 3), -1e-9))).any()


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.07])
def test_what_does_not_fit_the_grid_is_refused(value):
    with pytest.raises(ValueError, match="not finite or farther"):
        quantized(np.full((1, 3), value))


@pytest.mark.parametrize("damage", [lambda r: r[:-1], lambda r: r + b"0", lambda r: b"X" + r[1:]])
def test_a_damaged_record_is_named(damage):
    record = encode(box_body(0.04, 0.05, 0.06))
    with pytest.raises(UsageError, match="record is damaged"):
        decode(damage(record))
