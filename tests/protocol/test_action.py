import numpy as np
import pytest

from minitouch_bench.errors import InvalidActionError
from minitouch_bench.protocol.spec import fit_action


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, ">f8"])
@pytest.mark.parametrize("shape", [(4,), (1, 4)])
def test_floats_are_cast_and_a_batch_axis_is_dropped(dtype, shape):
    action = fit_action(np.full(shape, 0.5, dtype), 4)
    assert action.dtype == np.float32
    assert action.tolist() == [0.5] * 4


@pytest.mark.parametrize(
    ("given", "size", "taken"),
    [
        ([7.0, -7.0, 0.0, 0.0], 4, [7.0, -7.0, 0.0, 0.0]),  # unclipped
        ([0.0, 1.0, 2.0, 3.0, 4.0], 4, [0.0, 1.0, 2.0, 3.0]),
        ([1.0, 2.0, 3.0, 4.0], 5, [1.0, 2.0, 3.0, 4.0, 0.0]),
    ],
)
def test_four_or_five_numbers_serve_every_task(given, size, taken):
    raw = np.array(given, np.float32)
    fitted = fit_action(raw, size)
    assert fitted.tolist() == taken
    assert not np.shares_memory(fitted, raw)


@pytest.mark.parametrize(
    ("raw", "size", "text"),
    [
        (np.zeros(3), 5, "3 numbers, not 4 or 5"),
        (np.zeros((2, 4)), 4, "shape"),
        (np.float32(1.0), 4, "shape"),
        (np.zeros(4, int), 4, "type int64"),
        ([[1.0], [1.0, 2.0]], 4, "not an array"),
        ([0.0, np.nan, 0.0, 0.0], 4, "NaN"),
        ([0.0, 0.0, 0.0, np.inf], 4, "infinity"),
        ([0.0, 0.0, 0.0, 0.0, np.nan], 4, "NaN"),  # though a task of 4 does not use it
    ],
)
def test_anything_else_is_refused(raw, size, text):
    with pytest.raises(InvalidActionError, match=text):
        fit_action(raw, size)
