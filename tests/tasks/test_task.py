"""The four tasks: where things stand when an episode begins, what ends it, and own objects."""

import math

import numpy as np
import pytest

from minitouch_bench.episode import Outcome
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.policy_setup import Recording
from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.protocol.minitouch import OPENING, PICK_UP, PROTOCOL, PUSHING, CubeSpec
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.shapegen.generate import write_set
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set
from minitouch_bench.simulation.bodies import DOOR_JOINT, HANDLE_LINK
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.tasks.environment import OUTCOMES, MiniTouchEnv
from minitouch_bench.tasks.task import (
    START_XY,
    Opening,
    PickUp,
    Playing,
    Pushing,
    cube_model,
    draw_yaw,
)
from tests.shapegen.conftest import entry_of
from tests.tasks.playback import overlapping

TABLE_TOP_M = PROTOCOL.physics.table_top
CABINET = OPENING.cabinet


@pytest.fixture(scope="module")
def with_cube():
    return MiniTouchEnv("pick-up", objects="cube")


def drawn(task, attribute="position"):
    """Return the values of a task's attribute in two hundred draws."""
    rng, values = np.random.default_rng(0), []
    for _ in range(200):
        task.draw(rng, None)
        values.append(getattr(task, attribute))
    return np.array(values)


# Where things stand


@pytest.mark.parametrize(
    ("task", "low", "high", "clearance"),
    [
        (Playing(), (0.55, -0.15), (0.70, 0.20), 0.07),
        (PickUp(), (0.55, -0.15), (0.70, 0.15), 0.09),
    ],
)
def test_an_object_lies_within_its_margins_and_clear_of_the_hand(task, low, high, clearance):
    places = drawn(task)
    assert np.linalg.norm(places - START_XY, axis=1).min() >= clearance
    assert np.all(places >= low)
    assert np.all(places <= high)
    assert np.all(np.ptp(places, axis=0) > 0.85 * np.subtract(high, low))


def test_shapes_are_drawn_and_turned_at_random(environments):
    pool, rng = environments["pick-up"]._pool, np.random.default_rng(0)
    models = [pool.draw(rng) for _ in range(200)]
    assert len({model.name for model in models}) > 1
    assert {model.name for model in models} <= set(pool.names)
    yaws = [draw_yaw(rng, model) for model in models]
    assert np.histogram(yaws, 8, (0.0, math.tau))[0].min() > 5


def test_pushing_is_drawn_around_its_target_from_every_side():
    task, rng, space = Pushing(), np.random.default_rng(0), PUSHING.workspace
    angles, targets = [], []
    for _ in range(200):
        task.draw(rng, None)
        target, place, start = map(np.array, (task.target, task.position, task._start))
        away = (place - target) / math.dist(place, target)
        for center, around in ((target, place), (place, start)):
            assert 0.10 <= math.dist(center, around) <= 0.20
            assert space.holds(*around)
        assert space.holds(*(place + 0.07 * away))
        assert task.yaw == 0.0
        targets.append(target)
        angles.append(math.atan2(away[1], away[0]))
    assert np.all(np.array(targets) >= np.array(space.low[:2]) + 0.025)
    assert np.all(np.array(targets) <= np.array(space.high[:2]) - 0.025)
    assert np.all(np.ptp(targets, axis=0) > 0.38)  # of 0.40 m
    assert np.histogram(angles, 8, (-math.pi, math.pi))[0].min() > 5


def handle_position(front, middle, angle):
    """Return x, y (m) of the bar's middle with the door at ``angle`` (rad)."""
    outward = CABINET.door_thickness / 2 + CABINET.handle_thickness / 2
    hinge_x, hinge_y = front + CABINET.door_thickness / 2, middle + CABINET.hinge_y
    sine, cosine = math.sin(angle), math.cos(angle)
    x = hinge_x - CABINET.handle_radius * sine - outward * cosine
    y = hinge_y + CABINET.handle_radius * cosine - outward * sine
    return x, y


def test_every_placement_puts_the_shut_handle_in_reach():
    space, places = OPENING.workspace, drawn(Opening())
    for place in places:
        x, y = handle_position(*place, 0.0)
        assert space.low[0] <= x - CABINET.handle_thickness / 2 <= space.high[0]
        assert space.low[1] <= y <= space.high[1]
    assert np.ptp(places, axis=0) == pytest.approx((0.005, 0.22), rel=0.1)


def test_the_handle_is_where_the_cabinet_says(environments):
    environments["opening"].reset(seed=1)
    task, client = environments["opening"].task, environments["opening"].client
    for degrees in (0.0, 15.0, 40.0):
        client.set_joint(task.target_body, DOOR_JOINT, math.radians(degrees))
        x, y, _ = client.placed_link_position(task.target_body, HANDLE_LINK)
        expected = handle_position(*task.position, math.radians(degrees))
        assert (x, y) == pytest.approx(expected, abs=1e-6)


def test_no_episode_begins_in_contact_or_in_success(environment):
    for seed in range(20):
        observation, info = environment.reset(seed=seed)
        client, body = environment.client, environment.task.target_body
        assert not overlapping(client, environment.arm.body, body, 0.005)
        assert np.allclose(observation["touch"][:3], environment.arm.position, atol=1e-6)
        assert not info["success"]


def test_the_world_is_built_as_drawn(environments):
    for task, height in (("playing", 0.0025), ("pushing", 0.0)):
        for seed in range(5):
            _, info = environments[task].reset(seed=seed)
            place = environments[task].task.position
            assert info["object_state"] == pytest.approx((*place, height), abs=1e-6)
    hand = environments["pushing"].arm.position
    assert math.dist(hand, (*environments["pushing"].task._start, 0.02)) < 1e-3
    assert environments["playing"].arm.position[:2] == pytest.approx(START_XY, abs=5e-4)
    _, info = environments["opening"].reset(seed=1)
    assert info["object_state"].tolist() == [0.0]


def test_shapes_lie_still(environments):
    environment = environments["pick-up"]
    for name in environment._pool.names[:6]:
        _, info = environment.reset(seed=3, options={"object": name})
        for _ in range(60):
            environment.client.step()
        now = environment.task.object_state(environment.client)
        assert math.dist(info["object_state"], now) < 2e-3


def test_pushing_s_target_is_never_touched(environments):
    environment = environments["pushing"]
    environment.reset(seed=4)
    environment.arm.place((*environment.task.target, 0.02))
    *_, info = environment.step(np.array((0, 0, 0.2, 0), np.float32))
    assert info["contact_ticks"] == 0  # of the cube
    assert info["ticks"] < 100
    assert environment.client._bullet.getCollisionShapeData(environment.task._marker, -1) == ()


# What ends an episode


def put(x, y, z=TABLE_TOP_M + 0.025, tilt=0.0):
    turned = (math.sin(tilt / 2), 0.0, 0.0, math.cos(tilt / 2))
    return lambda world: world.client.set_pose(world.task.target_body, (x, y, z), turned)


def push(distance):
    return lambda world: put(world.task.target[0], world.task.target[1] + distance)(world)


def swing(degrees):
    angle = math.radians(degrees)
    return lambda world: world.client.set_joint(world.task.target_body, DOOR_JOINT, angle)


def lift(height, tilt):
    """Raise the lowest corner of Pick-up's cube to a height above the table."""
    lowest = 0.0225 * (math.cos(tilt) + math.sin(tilt))
    return put(0.6, 0.0, TABLE_TOP_M + lowest + height, tilt)


@pytest.mark.parametrize(
    ("task", "arrange", "outcome"),
    [
        ("playing", put(0.9, 0.9, 0.5), None),
        ("pushing", push(0.0695), Outcome.SUCCESS),
        ("pushing", push(0.0705), None),
        ("pushing", put(0.248, 0.0), Outcome.LEFT_WORKSPACE),
        ("pushing", put(0.698, 0.2), None),
        ("pushing", put(0.3, -0.202), Outcome.LEFT_WORKSPACE),
        ("pushing", put(0.3, 0.248), None),
        ("opening", swing(29.9), None),
        ("opening", swing(30.1), Outcome.SUCCESS),
        ("pick-up", lift(0.049, 0.0), None),
        ("pick-up", lift(0.052, 0.0), Outcome.SUCCESS),
        ("pick-up", lift(0.049, math.pi / 4), None),
        ("pick-up", lift(0.052, math.pi / 4), Outcome.SUCCESS),
        ("pick-up", put(PICK_UP.workspace.low[0] - 0.002, 0.0), Outcome.LEFT_WORKSPACE),
    ],
)
def test_an_episode_ends_by_its_task_s_rule(environments, with_cube, task, arrange, outcome):
    environment = with_cube if task == "pick-up" else environments[task]
    environment.reset(seed=4)
    arrange(environment)
    still = np.zeros(environment.action_space.shape, np.float32)
    _, reward, terminated, truncated, info = environment.step(still)
    assert OUTCOMES[info["outcome"]] is outcome
    assert (terminated, truncated) == (outcome is not None, False)
    assert info["success"] == (outcome is Outcome.SUCCESS)
    assert reward == (25.0 if outcome is Outcome.SUCCESS else 0.0)


# How each task moves and feels


def test_the_yaw_stays_within_45_degrees(environments):
    environment = environments["opening"]
    environment.reset(seed=1)
    yaws = []
    for turn in [-1] * 5 + [1] * 8:
        environment.step(np.array((0, 0, 0.1, 0, turn), np.float32))
        yaws.append(environment.arm.yaw)
    assert yaws[:5] == pytest.approx([-0.3, -0.6] + [-math.pi / 4] * 3)
    assert 0.0 < yaws[-1] <= max(yaws) <= math.pi / 4


@pytest.mark.parametrize("task", ["opening", "pick-up"])
def test_the_gripper_is_open_or_closed(environments, task):
    environment = environments[task]
    environment.reset(seed=1)
    arm, openings = environment.arm, []
    assert arm.gripper_opening == 1.0
    for step, value in enumerate((-1.0, 0.2, 0.2, 0.1, -0.1, -0.2, -1.0, 1.0)):
        action = np.zeros(environment.action_space.shape, np.float32)
        # Up and down in turn: a step lasts as long as its motion.
        action[2:4] = (-0.5 if step % 2 else 0.5, value)
        environment.step(action)
        openings.append(arm.gripper_opening)
    expected = [0.0, 0.375, 0.75, 0.9375, 0.75, 0.375, 0.0, 1.0]
    assert openings == pytest.approx(expected, abs=1e-6)
    assert arm._finger_targets(0.0) == [0.04, 0.04]
    assert arm._finger_targets(-0.2) == [0.04, 0.04]
    assert arm._finger_targets(-0.1) == [0.0, 0.0]


def test_the_gripper_of_playing_is_continuous(environments):
    environment = environments["playing"]
    environment.reset(seed=1)
    for _ in range(4):  # a step with a motion, so that it lasts
        environment.step(np.array((0, 0, 0.4, 0.2), np.float32))
    assert 0.3 < environment.step(np.zeros(4, np.float32))[0]["touch"][3] <= 1.0


def test_a_squeeze_is_felt_and_free_air_is_not(with_cube):
    environment = with_cube
    environment.reset(seed=1)
    rng, free = np.random.default_rng(0), []
    for _ in range(20):  # up, then about in the air
        action = rng.uniform(-1.0, 1.0, 4).astype(np.float32)
        action[2] = abs(action[2])
        free.append(environment.step(action)[0]["touch"][[6, 9]])
    assert np.abs(free).max() == 0.0
    x, y, _ = environment.client.pose(environment.task.target_body).position
    while math.dist(environment.arm.position, (x, y, 0.0)) > 0.003:
        hand = np.array(environment.arm.position)
        low = 0.0 if math.dist(hand[:2], (x, y)) < 0.003 else 0.06
        offset = np.clip((np.array((x, y, low)) - hand) / 0.06, -1.0, 1.0)
        environment.step(np.array((*offset, 1.0), np.float32))
    for step in range(4):
        action = np.array((0.0, 0.0, 0.05 * (-1) ** step, -1.0), np.float32)
        observation, *_ = environment.step(action)
    left, right = observation["touch"][[6, 9]]
    assert min(abs(left), abs(right)) > 15.0
    assert left * right < 0.0  # the fingers press against each other


# Own objects


def test_the_lowest_point_is_that_of_the_simulator():
    client, rng, cube = PhysicsClient(), np.random.default_rng(0), cube_model(CubeSpec(0.05, 1.0))
    body = cube.load(client, 0.5, 0.1, 0.3)
    for _ in range(20):
        quaternion = rng.normal(size=4)
        client.set_pose(body, (0.0, 0.0, 0.3), quaternion / np.linalg.norm(quaternion))
        (*_, low), (*_, high) = client._bullet.getAABB(body)
        assert cube.heights(client, body) == pytest.approx((low, high), abs=2e-3)


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
    assert {environment._pool.draw(np.random.default_rng(i)).name for i in range(20)} == {
        shape.name for shape in (named.shapes[:2] if given == "list" else named.shapes)
    }
    for other in ("shape-0001", *(["shape-0003"] if given == "list" else [])):
        with pytest.raises(UsageError, match=other):
            environment.reset(seed=1, options={"object": other})


def test_an_evaluation_plays_the_user_s_cube(named):
    plan = make_plan("smoke", ["pushing"], 1, objects=str(named.path))
    (spec,) = plan.specs()
    assert spec.shape == "cube"
    runner = EpisodeRunner(Recording({spec: np.zeros((1, 4), np.float32)}, plan))
    runner.run(spec)
    assert runner._world_of("pushing").task.model.urdf == named.shapes[0].urdf


def test_what_cannot_be_drawn_from_is_refused(named):
    other = canonical_shape_set().by_name("shape-0003")
    assert other != named.by_name("shape-0003")
    for objects in ([other, *named.shapes], 3, (), [3]):
        with pytest.raises(UsageError, match="objects"):
            MiniTouchEnv("pushing", objects=objects)
    MiniTouchEnv("pushing", objects=[other, other])
