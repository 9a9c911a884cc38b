import numpy as np
import pytest

from minitouch_bench.shapegen.geometry import surface_points
from minitouch_bench.shapegen.grips import plan_grasp
from tests.shapegen.bodies import box


@pytest.mark.parametrize(
    ("sides", "width"), [((0.06, 0.02, 0.03), 0.02), ((0.09, 0.09, 0.03), np.inf)]
)
def test_a_bar_is_gripped_across_and_a_slab_not_at_all(sides, width):
    grasp = plan_grasp(surface_points(box(*sides), 0.003) + np.array([0.0, 0.0, 0.015]))
    assert grasp.width == pytest.approx(width, abs=1e-3)
    assert abs(grasp.x) < 0.004
    assert abs(grasp.y) < 1e-3
