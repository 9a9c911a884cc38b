import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import CubeSpec
from minitouch_bench.shapegen.manifest import load_shape_set
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import cube_model
from tests.shapegen.conftest import subset

CUBE = cube_model(CubeSpec(0.05, 1.0))


def test_the_lowest_point_is_that_of_the_simulator():
    client, rng = PhysicsClient(), np.random.default_rng(0)
    body = CUBE.load(client, 0.5, 0.1, 0.3)
    for _ in range(20):
        quaternion = rng.normal(size=4)
        client.set_pose(body, (0.0, 0.0, 0.3), quaternion / np.linalg.norm(quaternion))
        assert CUBE.lowest_point(client, body) == pytest.approx(client.lowest_point(body), abs=2e-3)
    client.close()


def test_a_set_of_one_s_own_is_drawn_from(tmp_path):
    shapes = load_shape_set(subset(tmp_path / "set", 8))
    environment = MiniTouchEnv("pick-up", objects=shapes)
    drawn = set()
    for seed in range(8):
        environment.reset(seed=seed)
        drawn.add(environment.object_name)
    environment.close()
    assert drawn <= {shape.name for shape in shapes.shapes}
    assert len(drawn) > 1


@pytest.mark.parametrize("objects", [3, (), [3]])
def test_what_is_no_object_is_named(objects):
    with pytest.raises(UsageError):
        MiniTouchEnv("pick-up", objects=objects)
