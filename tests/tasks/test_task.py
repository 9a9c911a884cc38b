import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.policy_setup import Recording
from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.protocol.minitouch import CubeSpec
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.shapegen.generate import write_set
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import cube_model
from tests.shapegen.conftest import entry_of, subset

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


@pytest.fixture
def named(tmp_path):
    """Return a set of three shapes that are called as the task's cube and canonical shapes are."""
    made = [
        ({**entry_of(index), "name": name}, canonical_shape_set().shapes[index].record())
        for index, name in enumerate(("cube", "shape-0900", "shape-0003"))
    ]
    (tmp_path / "set").mkdir()
    write_set(tmp_path / "set", {"name": "named", "generator": 1, "seed": 0}, made)
    return load_shape_set(tmp_path / "set")


@pytest.mark.parametrize("given", ["set", "folder", "list"])
def test_a_name_means_the_shape_of_one_s_own_set(named, given):
    objects = {"set": named, "folder": str(named.path), "list": list(named.shapes[:2])}[given]
    environment = MiniTouchEnv("pushing", objects=objects)
    for shape in named.shapes[:2]:
        environment.reset(seed=1, options={"object": shape.name})
        assert environment.task.model.urdf == shape.urdf
        assert not environment.task.model.is_task_cube
    for other in ("shape-0001", *(["shape-0003"] if given == "list" else [])):
        with pytest.raises(UsageError, match=other):
            environment.reset(seed=1, options={"object": other})
    environment.close()


def test_an_evaluation_plays_the_user_s_cube(named):
    plan = make_plan("smoke", ["pushing"], 1, objects=str(named.path))
    (spec,) = plan.specs()
    assert spec.shape == "cube"
    runner = EpisodeRunner(Recording({spec: np.zeros((1, 4), np.float32)}, plan))
    runner.run(spec)
    assert runner._world_of("pushing").task.model.urdf == named.shapes[0].urdf
    runner.close()


def test_two_objects_of_one_name_are_refused(named):
    other = canonical_shape_set().by_name("shape-0003")
    assert other != named.by_name("shape-0003")
    with pytest.raises(UsageError, match="shape-0003"):
        MiniTouchEnv("pushing", objects=[other, *named.shapes])
    MiniTouchEnv("pushing", objects=[other, other]).close()


@pytest.mark.parametrize("objects", [3, (), [3]])
def test_what_is_no_object_is_named(objects):
    with pytest.raises(UsageError):
        MiniTouchEnv("pick-up", objects=objects)
