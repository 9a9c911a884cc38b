"""The four environments, as Gymnasium and Stable-Baselines3 see them, and their promises."""

import copy
import gc
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec, load_env_creator
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_checker import data_equivalence as equal

import minitouch_bench as mt
from minitouch_bench.episode import Outcome
from minitouch_bench.errors import InvalidActionError, UsageError
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.shapegen.manifest import choose_shapes
from minitouch_bench.simulation.bodies import DOOR_JOINT
from minitouch_bench.simulation.client import pybullet
from minitouch_bench.simulation.observation import GrayCamera
from minitouch_bench.tasks.environment import OUTCOMES, MiniTouchEnv
from minitouch_bench.tasks.task import TASK_CLASSES
from tests.tasks.playback import digest, play, random_actions

STEPS = 12


def zero(environment):
    return np.zeros(environment.action_space.shape, np.float32)


def test_spaces(environment):
    size = 5 if environment.task.spec.name == "opening" else 4
    limit = 200.0 if environment.task.spec.name == "pick-up" else 50.0
    action, observed = environment.action_space, environment.observation_space
    assert (action.shape, action.dtype) == ((size,), np.float32)
    assert (action.low.min(), action.high.max()) == (-1.0, 1.0)
    assert set(observed.spaces) == {"image", "touch"}
    assert (observed["image"].shape, observed["image"].dtype) == ((1, 84, 84), np.uint8)
    assert (observed["touch"].shape, observed["touch"].dtype) == ((11,), np.float32)
    assert observed["touch"].low[5:].tolist() == [-limit] * 6
    assert observed["touch"].high[3:].tolist() == [1.0] * 2 + [limit] * 6


@pytest.mark.parametrize("task", TASK_CLASSES)
def test_gymnasium_finds_nothing_to_warn_of_in_what_it_makes_and_draws(task):
    made = gymnasium.make(
        f"minitouch_bench:{PROTOCOL.task(task).gym_id}",
        render_mode="rgb_array",
        width=64,
        height=48,
    )
    check_env(made.unwrapped)
    made.close()


def test_stable_baselines_finds_nothing_to_warn_of(environment):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(environment, warn=True, skip_render_check=True)


def test_info_has_the_same_keys_and_numpy_values_at_reset_and_step(environment):
    _, first = environment.reset(seed=4)
    *_, second = environment.step(zero(environment))
    assert list(first) == list(second)
    for before, after in zip(first.values(), second.values(), strict=True):
        assert isinstance(before, np.ndarray | np.generic)
        assert before.dtype == after.dtype
        assert before.shape == after.shape
    assert (first["ticks"], first["outcome"], first["first_touch_tick"]) == (0, 0, -1)
    assert second["ticks"] > 0
    assert first["is_success"] == first["success"] == False  # noqa: E712  numpy's


def test_a_step_or_a_picture_before_the_first_reset_says_so():
    environment = mt.make("playing", render_mode="rgb_array")
    with pytest.raises(ResetNeeded):
        environment.step(zero(environment))
    with pytest.raises(ResetNeeded):
        environment.render()
    environment.reset(seed=0)
    again = pickle.loads(pickle.dumps(environment))
    with pytest.raises(ResetNeeded):
        again.step(zero(environment))


def test_a_closed_environment_is_not_used_again():
    closed = mt.make("playing", render_mode="rgb_array")
    closed.reset(seed=1)
    closed.close()
    later = mt.make("playing", render_mode="rgb_array")  # it gets the numbers of the closed worlds
    seen = digest(later.unwrapped, 7, 3)
    for use in (closed.reset, closed.render, lambda: closed.step(zero(closed))):
        with pytest.raises(UsageError, match="closed"):
            use()
    closed.close()
    assert digest(later.unwrapped, 7, 3) == seen


def test_an_environment_that_nothing_uses_frees_its_worlds():
    environment = mt.make("playing", render_mode="rgb_array")
    environment.reset(seed=1)
    assert environment.render().shape == (240, 240, 3)
    made = environment.unwrapped
    clients = made.client, made._kinematics._client, made._renderer._client
    numbers = [client._bullet.id for client in clients]
    assert len({*numbers}) == 3
    del environment, made, clients
    gc.collect()
    assert not any(pybullet.isConnected(number) for number in numbers)


@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("opening", {}),
        ("pick-up", {"objects": choose_shapes("train")[7:8], "max_episode_steps": 3}),
    ],
)
def test_pickling_gives_an_equal_new_environment_and_copying_none(task, options):
    first = MiniTouchEnv(task, **options, render_mode="rgb_array", width=64, height=48)
    seen = digest(first, 7, 5)
    second = pickle.loads(pickle.dumps(first))
    assert second.client is not first.client
    assert digest(second, 7, 5) == seen
    assert second.object_name == first.object_name
    assert second.render().shape == (48, 64, 3)
    with pytest.raises(TypeError, match="cannot be copied"):
        copy.deepcopy(first)


def test_the_registration_tells_limit_and_metadata(environment):
    spec = gymnasium.spec(environment.task.spec.gym_id)
    assert spec.max_episode_steps == environment.task.spec.max_steps == 200
    assert load_env_creator(spec.entry_point).metadata == MiniTouchEnv.metadata


# One seed and the same actions: the same bits, whatever else happens


def test_the_same_bits_twice_and_after_other_episodes(environment):
    first = digest(environment, 7, STEPS)
    other = digest(environment, 8, STEPS)
    assert digest(environment, 7, STEPS) == first != other


@pytest.mark.parametrize(("one", "other"), [("pushing", "pushing"), ("pick-up", "opening")])
def test_two_interleaved_environments_do_not_disturb_each_other(one, other, environments):
    first, second = environments[one], MiniTouchEnv(other)
    alone = [list(play(first, 3, STEPS)), list(play(second, 5, STEPS))]
    together = list(zip(play(first, 3, STEPS), play(second, 5, STEPS), strict=False))
    assert len(together) > 5
    assert together == list(zip(*alone, strict=False))


def test_pictures_for_people_change_nothing(environment):
    plain = list(play(environment, 9, 2))
    pictured = [seen for seen in play(environment, 9, 2) if environment.picture() is not None]
    assert pictured == plain


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vector_environments_give_the_same_as_single_ones(mode, environments):
    vector = gymnasium.make_vec(
        "minitouch_bench:MiniTouch/Pushing-v1", num_envs=2, vectorization_mode=mode
    )
    observed, _ = vector.reset(seed=[11, 12])
    actions = random_actions(environments["pushing"], 0, 2)
    stepped, *_, info = vector.step(actions)
    vector.close()
    assert info["is_success"].dtype == bool
    assert info["object_state"].shape == (2, 3)
    single = environments["pushing"]
    for row, seed in enumerate((11, 12)):
        first, _ = single.reset(seed=seed)
        second, *_ = single.step(actions[row])
        for name in ("image", "touch"):
            assert np.array_equal(observed[name][row], first[name])
            assert np.array_equal(stepped[name][row], second[name])


def test_an_unseeded_reset_goes_on_from_the_last_seed(environments):
    environment = environments["pushing"]
    environment.reset(seed=1)
    first, _ = environment.reset()
    second, _ = environment.reset()
    environment.reset(seed=1)
    again, _ = environment.reset()
    assert equal(first, again)
    assert not equal(first, second)


# Actions


def test_an_action_that_is_no_number_never_reaches_the_simulator(environment):
    environment.reset(seed=2)
    for value in (np.nan, np.inf, -np.inf):
        bad = zero(environment)
        bad[-1] = value
        with pytest.raises(InvalidActionError, match="NaN or infinity"):
            environment.step(bad)
    seen = [environment.step(action)[0] for action in random_actions(environment, 2, 3)]
    environment.reset(seed=2)
    for before, action in zip(seen, random_actions(environment, 2, 3), strict=True):
        assert equal(before, environment.step(action)[0])


def test_an_action_out_of_range_is_clipped_and_counted(environment):
    environment.reset(seed=5)
    *_, info = environment.step(zero(environment) + np.float32(0.5))
    assert not info["clipped"]
    environment.reset(seed=5)
    inside, *_ = environment.step(zero(environment) - np.float32(1.0))
    environment.reset(seed=5)
    outside, *_, info = environment.step(zero(environment) - np.float32(3.0))
    assert info["clipped"]
    assert info["action"].tolist() == [-1.0] * len(info["action"])
    assert equal(inside, outside)


# The end of an episode


@pytest.mark.parametrize("limit", [3, 203])
def test_gymnasium_s_step_limit_is_an_outcome_like_the_task_s_own(limit):
    made = mt.make("playing", max_episode_steps=limit)
    spec = EnvSpec.from_json(made.spec.to_json())
    ours = MiniTouchEnv("playing", max_episode_steps=limit)
    for environment in (made, pickle.loads(pickle.dumps(made)), gymnasium.make(spec), ours):
        environment.reset(seed=1)
        for step in range(1, limit + 1):
            *_, terminated, truncated, info = environment.step(zero(environment))
            assert (terminated, truncated) == (False, step == limit)
            assert OUTCOMES[info["outcome"]] is (Outcome.STEP_LIMIT if truncated else None)


def test_a_success_in_the_last_step_is_not_truncated():
    for environment in (
        mt.make("opening", max_episode_steps=1),
        MiniTouchEnv("opening", max_episode_steps=1),
    ):
        environment.reset(seed=1)
        world = environment.unwrapped
        world.client.set_joint(world.task.target_body, DOOR_JOINT, 0.6)
        *_, terminated, truncated, info = environment.step(zero(environment))
        assert (terminated, truncated) == (True, False)
        assert OUTCOMES[info["outcome"]] is Outcome.SUCCESS


def test_objects_are_asked_for_by_name(environments):
    environment = environments["pick-up"]
    names = environment._pool.names
    environment.reset(seed=1, options={"object": names[-1]})
    assert environment.object_name == names[-1]
    environment.reset(seed=1)
    assert environment.object_name in names
    with pytest.raises(UsageError, match="'moon'"):
        environment.reset(seed=1, options={"object": "moon"})
    with pytest.raises(UsageError, match="opening has no object"):
        environments["opening"].reset(options={"object": "cube"})
    for options in ({"shape": "cube"}, {"object": ["cube"]}, {1: 1}):
        with pytest.raises(UsageError, match="reset option"):
            environment.reset(seed=1, options=options)


def test_an_object_that_is_never_visible_is_an_error(environments, monkeypatch):
    environment = environments["pick-up"]
    nothing = np.full((84, 84), -1)
    monkeypatch.setattr(environment._camera, "visible_bodies", lambda _: nothing)
    with pytest.raises(UsageError, match="less than 15 pixels are visible in each of 50 scenes"):
        environment.reset(seed=1)


# Pictures


def test_a_picture_has_its_size_and_something_on_it(environments):
    environment = MiniTouchEnv("pushing", render_mode="rgb_array", width=90, height=200)
    environment.reset(seed=1)
    picture = environment.render()
    assert (picture.shape, picture.dtype) == ((200, 90, 3), np.uint8)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50
    for action in random_actions(environment, 1, 3):
        environment.step(action)
    assert np.any(environment.render() != picture)
    assert environments["pushing"].render() is None
    with pytest.raises(UsageError, match="human"):
        MiniTouchEnv("pushing", render_mode="human")


class WholeCamera(GrayCamera):
    """Draws everything, each time."""

    def keep_background(self, client, table, static_parts):
        self._table = table

    def visible_bodies(self, client):
        return client.render(self._camera, 84, 84, bodies=True).bodies

    def capture(self, client, shadows=()):
        image = client.render(self._camera, 84, 84, bodies=True)
        self._background = (image.rgb @ (0.2989, 0.5870, 0.1140)).round().astype(np.uint8)
        self._is_table = image.bodies == self._table
        return self._shaded(shadows)[np.newaxis]


def test_the_composed_image_is_that_of_the_whole_scene(environment):
    whole = MiniTouchEnv(environment.task.spec.name)
    whole._camera = WholeCamera(whole.task.spec.camera)
    differing = pixels = 0
    for seed in (1, 2):
        images = [[world.reset(seed=seed)[0]["image"]] for world in (environment, whole)]
        for action in random_actions(environment, seed, 8):
            for world, seen in zip((environment, whole), images, strict=True):
                observation, _, terminated, *_ = world.step(action)
                seen.append(observation["image"])
            if terminated:
                break
        differences = np.abs(np.subtract(*np.array(images, int)))
        differing, pixels = differing + (differences > 2).sum(), pixels + differences.size
    assert differing / pixels < 1e-3
