import numpy as np

from minitouch_bench.protocol.spec import CameraSpec
from minitouch_bench.simulation.client import pixels_of
from minitouch_bench.simulation.observation import seen_on_plane


def test_the_pixels_of_points_are_where_the_camera_sees_them():
    camera = CameraSpec((0.5, 0.1, 0.0), 30.0, -50.0, near=0.1)
    x, y = seen_on_plane(camera, 0.02, (60, 40))
    row, column = pixels_of(camera, x, y, 0.02, (60, 40))
    expected = np.indices((40, 60))
    np.testing.assert_array_equal((row, column), expected)
