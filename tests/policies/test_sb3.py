import base64
import importlib
import io
import json
import sys
import warnings

import cloudpickle
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.wrappers import ClipAction, RescaleAction

from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.evaluation.policy_setup import try_policy
from minitouch_bench.policies import sb3
from minitouch_bench.policies.policy import PolicySource, load_policy
from minitouch_bench.policies.python_objects import keep_in_memory, load_object
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.simulation.observation import observation_space
from tests.archives import members, zipped
from tests.policies.recipes import StillEnvironment, run_recipes

stable_baselines3 = pytest.importorskip("stable_baselines3")
from stable_baselines3.common.policies import MultiInputActorCriticPolicy  # noqa: E402

WEIGHTS = "policy.pth"


class Sinking(StillEnvironment):
    """Its touch vector stays in the benchmark's range, and sinks from step to step."""

    def reset(self, **options):
        self.touch = 0.9
        return self.observe(), {}

    def step(self, action):
        self.touch -= 0.01
        return self.observe(), 0.0, False, False, {}

    def observe(self):
        return {**self.observation_space.sample(), "touch": np.full(11, self.touch, np.float32)}


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    directory = tmp_path_factory.mktemp("sb3")
    names = run_recipes(directory, "stable_baselines3")
    return names["model"], (directory / "policy.zip").read_bytes()


def make(algorithm, environment=None, **settings):
    options = {"buffer_size": 10} if algorithm in ("SAC", "TD3", "DDPG") else {"n_steps": 8}
    if algorithm == "PPO":
        options["batch_size"] = 8
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about spaces, and not ours
        return getattr(stable_baselines3, algorithm)(
            settings.pop("policy", "MultiInputPolicy"),
            environment or StillEnvironment(4),
            policy_kwargs=settings,
            **options,
        )


def saved(model):
    buffer = io.BytesIO()
    model.save(buffer)
    return buffer.getvalue()


def changed(content, **others):
    """Return a zip with members replaced."""
    return zipped({**members(content), **others})


def load(content, **options):
    policy = load_policy(PolicySource("sb3", "x", "x.zip", content=content, **options))
    policy.reset(7, "pushing")
    return policy


def refused(content, match):
    with pytest.raises(PolicyLoadError, match=match) as caught:
        load(content)
    assert len(str(caught.value).splitlines()) == 1


def test_the_recipe_acts_as_its_model_predicts_and_samples_from_the_seed(recipe, observation):
    model, content = recipe
    wanted, _ = model.predict(observation, deterministic=True)
    assert np.array_equal(load(content).act(observation), wanted)
    drawn = [load(content, deterministic=False).act(observation).tolist() for _ in range(2)]
    assert drawn[0] == drawn[1] != wanted.tolist()


@pytest.mark.parametrize(
    ("algorithm", "settings"),
    [
        ("TD3", {"net_arch": {"pi": [16], "qf": [8, 8]}}),
        ("PPO", {"activation_fn": torch.nn.ELU, "net_arch": {"pi": [8], "vf": [16]}}),
        ("A2C", {"share_features_extractor": False, "net_arch": [8]}),
    ],
)
def test_the_network_of_another_algorithm_is_rebuilt(algorithm, settings, observation):
    model = make(algorithm, **settings, features_extractor_kwargs={"cnn_output_dim": 16})
    wanted, _ = model.predict(observation, deterministic=True)
    assert np.array_equal(load(saved(model)).act(observation), wanted)


def test_a_module_of_its_own_is_saved_in_the_zip(tmp_path, monkeypatch, observation):
    text = "from stable_baselines3.common.torch_layers import CombinedExtractor\n"
    (tmp_path / "own_layers.py").write_text(f"{text}class Own(CombinedExtractor):\n    pass\n")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(tmp_path)
        module = importlib.import_module("own_layers")
        model = make("SAC", features_extractor_class=module.Own, net_arch=[8])
        wanted, _ = model.predict(observation, deterministic=True)
        named = saved(model)
        cloudpickle.register_pickle_by_value(module)
        whole = saved(model)
        cloudpickle.unregister_pickle_by_value(module)
    monkeypatch.delitem(sys.modules, "own_layers")
    with pytest.raises(PolicyLoadError, match=r"own_layers.*register_pickle_by_value"):
        load(named)
    assert np.array_equal(load(whole).act(observation), wanted)


def settings_of(content):
    return json.loads(members(content)["data"])


def test_only_what_describes_the_policy_is_opened(recipe, observation):
    _, content = recipe
    settings = settings_of(content)
    others = [
        name
        for name, setting in settings.items()
        if isinstance(setting, dict) and name not in sb3.SETTINGS
    ]
    assert len(others) >= 4
    for name in others:
        settings[name] = {":serialized:": "bm8gcGlja2xl"}
    wanted = load(content).act(observation)
    bare = load(changed(content, data=json.dumps(settings)))
    assert np.array_equal(bare.act(observation), wanted)


def test_files_of_another_form_are_refused(recipe):
    _, content = recipe
    refused(changed(content, data="{}"), "not a readable sb3 policy: KeyError: 'observation_space'")
    refused(changed(content, data="[" * 100_000), "not a readable sb3 policy")
    refused(changed(content, **{WEIGHTS: b"\x80\x04."}), "no plain weights")
    other = members(saved(make("SAC", StillEnvironment(5), net_arch=[32])))
    refused(changed(content, **{WEIGHTS: other[WEIGHTS]}), "size mismatch")


@pytest.mark.parametrize(
    ("module", "advice"),
    [
        ("sb3_contrib.tqc", "pip install sb3-contrib"),
        ("gym.spaces", "1.x"),
        ("nowhere", "No module named.*register_pickle_by_value"),
    ],
)
def test_a_package_that_is_missing_is_told_from_a_module_of_the_user_s(recipe, module, advice):
    _, content = recipe
    pickled = base64.b64encode(f"c{module}\nPolicy\n.".encode()).decode()
    settings = {**settings_of(content), "policy_class": {":serialized:": pickled}}
    refused(changed(content, data=json.dumps(settings)), advice)


SMALL = {"net_arch": [8], "features_extractor_kwargs": {"cnn_output_dim": 8}}


def test_a_model_that_learned_other_observations_or_actions_is_refused():
    refused(saved(make("SAC", StillEnvironment(4, (3, 84, 84)))), "another observation")
    pendulum = stable_baselines3.SAC("MlpPolicy", "Pendulum-v1", buffer_size=10)
    refused(saved(pendulum), "another observation")
    counted = StillEnvironment()
    counted.action_space = spaces.MultiDiscrete([3] * 4)
    for model in (
        make("SAC", StillEnvironment(7), **SMALL),
        make("SAC", RescaleAction(StillEnvironment(4), *np.float32([0, 1])), **SMALL).learn(16),
        make("PPO", RescaleAction(StillEnvironment(4), *np.float32([-2, 2])), **SMALL).learn(8),
        make("PPO", counted, **SMALL),
    ):
        refused(saved(model), "other actions")
        with pytest.raises(PolicyLoadError, match="other actions"):
            load_object(keep_in_memory(model))


def test_actions_without_bounds_are_clipped_as_any_other(observation):
    environment = ClipAction(StillEnvironment(4))
    spaces_of = environment.observation_space, environment.action_space
    policy = MultiInputActorCriticPolicy(*spaces_of, lambda _: 0.0, net_arch=[8])
    wanted, _ = policy.predict(observation, deterministic=True)
    loaded = load_object(keep_in_memory(policy))
    loaded.reset(0, "pushing")
    assert np.array_equal(loaded.act(observation), wanted)


def test_a_policy_with_a_state_keeps_it_for_the_episode(observation):
    class Counting:
        observation_space = StillEnvironment(4).observation_space
        action_space = StillEnvironment(4).action_space

        def predict(self, observation, state, deterministic):
            return np.full(4, state or 0.0), (state or 0) + 1

    policy = sb3.Sb3Policy(Counting(), True)
    for _ in range(2):
        policy.reset(0, "pushing")
        assert [policy.act(observation)[0] for _ in range(3)] == [0, 1, 2]


def test_a_model_that_is_loaded_again_is_the_same_policy(tmp_path):
    model = make("PPO", **SMALL).learn(8)
    model.save(file := tmp_path / "policy.zip")
    digests = {keep_in_memory(stable_baselines3.PPO.load(file)).digest for _ in range(2)}
    assert len(digests) == 1
    assert keep_in_memory(make("PPO", **SMALL)).digest not in digests


def test_a_model_of_stacked_frames_acts_as_it_does_in_its_training():
    from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack

    inner = DummyVecEnv([lambda: Sinking(4)])
    stacked = VecFrameStack(inner, 3)
    model = make("SAC", stacked, **SMALL)
    policies = load(saved(model)), load_object(keep_in_memory(model))
    for _ in range(2):
        seen = stacked.reset()
        for policy in policies:
            policy.reset(0, "pushing")
        for _ in range(5):
            wanted, _ = model.predict(seen, deterministic=True)
            newest = {"image": seen["image"][0, -1:], "touch": seen["touch"][0, -11:]}
            for policy in policies:
                assert np.array_equal(policy.act(newest), wanted[0])
            seen, *_ = stacked.step(wanted)
    channels_last = VecFrameStack(inner, 3, channels_order="last")
    refused(saved(make("SAC", channels_last, **SMALL)), "joined by VecFrameStack")


def test_a_model_that_learned_on_smaller_forces_is_refused(tmp_path):
    scaled, strong = StillEnvironment(4), StillEnvironment()
    scaled.observation_space["touch"] = spaces.Box(-1.0, 1.0, (11,), np.float32)
    strong.observation_space = observation_space(200.0)
    refused(saved(make("PPO", scaled, net_arch=[8])), "forces of at most 1;")
    model = make("PPO", net_arch=[8])
    (tmp_path / "policy.zip").write_bytes(saved(model))
    for policy in (parse_source(str(tmp_path / "policy.zip")), keep_in_memory(model)):
        assert try_policy(policy, ["pushing", "opening"]) == ()
        with pytest.raises(PolicyLoadError, match=r"at most 50; those of pick-up .* 200"):
            try_policy(policy, ["pushing", "pick-up", "opening"])
    try_policy(keep_in_memory(make("PPO", strong, net_arch=[8])), ["pushing", "pick-up"])


def test_a_model_whose_observations_were_normalized_is_refused(observation, tmp_path):
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    def plain():  # VecNormalize changes the space of what it wraps
        return DummyVecEnv([lambda: Sinking(4)])

    for key in ("touch", "image"):
        model = make("SAC", VecNormalize(plain(), norm_obs_keys=[key]), net_arch=[8]).learn(16)
        refused(saved(model), "under VecNormalize")
        model.save(file := tmp_path / "policy.zip")
        loaded = stable_baselines3.SAC.load(file, env=VecNormalize(plain(), norm_obs_keys=[key]))
        for one in (model, loaded):
            with pytest.raises(PolicyLoadError, match=r"^it was trained under VecNormalize"):
                keep_in_memory(one)
    for environment in (plain(), VecNormalize(plain(), norm_obs=False)):
        model = make("SAC", environment, net_arch=[8]).learn(16)
        assert load(saved(model)).act(observation).shape == (4,)
        policy = load_object(keep_in_memory(model))
        policy.reset(0, "pushing")
        assert policy.act(observation).shape == (4,)
