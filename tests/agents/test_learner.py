"""A learner: what it saves acts as what it learned."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from minitouch_bench.agents import learner as learners
from minitouch_bench.agents.config import PhaseConfig, SacConfig, TrainingConfig
from minitouch_bench.agents.keypoints import Keypoints
from minitouch_bench.agents.learner import Learner, TouchScale, kept_size
from minitouch_bench.agents.memory import ReplayMemory
from minitouch_bench.perturbation import SENSES
from minitouch_bench.policies.native import load_native, save_native
from minitouch_bench.policies.networks import ENCODER_CHANNELS, KEYPOINT_FEATURES
from minitouch_bench.policies.policy import PolicySource
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import Workspace
from minitouch_bench.simulation.observation import SENSED_TOUCH
from tests.agents.batches import random_batch


def make_learner(*, keypoints=False, without=(), task_without=(), **settings):
    """Return a learner that explores, or one in a task phase that sees keypoints."""
    task_phase = PhaseConfig(10, keypoint_updates=5, fitting_updates=2, without=task_without)
    exploration = replace(TrainingConfig("pushing").exploration, without=without)
    settings = {"task_phase": task_phase, "exploration": exploration, **settings}
    config = TrainingConfig("pushing", **settings)
    learner = Learner(config, PROTOCOL.task("pushing"), torch.device("cpu"))
    if keypoints:
        learner.begin_task_phase(filled_replay())
    return learner


def mean_action(learner, image, touch):
    """Return the policy's mean action as it is in training, before squashing."""
    seen, felt = learner._seen(image, learner.scale.scaled(touch))
    return learner.sac.actor.gaussian_of(learner.sac.encoder(seen), felt)[0]


@pytest.mark.parametrize("keypoints", [False, True])
def test_a_policy_is_saved_in_half_precision_and_acts_the_same(tmp_path, keypoints):
    sac = SacConfig(batch_size=4, encoder_width=0.25, bfloat16=False)
    learner = make_learner(keypoints=keypoints, sac=sac)
    batch = random_batch()
    with torch.no_grad():
        mean = mean_action(learner, batch.image, batch.touch)
        saved = learner.actor()
        action = saved(batch.image, batch.touch)
    if not keypoints:
        assert saved.encoder.convolutions[0].out_channels < ENCODER_CHANNELS[0]
    torch.testing.assert_close(action, torch.tanh(mean), atol=2e-3, rtol=0)  # half precision

    file = tmp_path / "policy.safetensors"
    save_native(saved, file)
    # 2.2 MB at full width and precision
    assert file.stat().st_size < (80_000 if keypoints else 350_000)
    loaded = load_native(PolicySource("native", "x", str(file), content=file.read_bytes()))
    observation = {"image": batch.image[0].numpy(), "touch": batch.touch[0].numpy()}
    with torch.no_grad():
        first = saved(batch.image[:1], batch.touch[:1])[0].numpy()
    assert np.array_equal(loaded.act(observation), first)


def filled_replay():
    memory, rng = ReplayMemory(100, 11, 4, kept_size(4)), np.random.default_rng(0)
    image = rng.integers(0, 256, (1, 84, 84), dtype=np.uint8)
    memory.begin_episode(image, np.zeros(11, np.float32))
    for _ in range(20):
        touch, action = (rng.normal(size=size).astype(np.float32) for size in (11, 4))
        memory.add(action, 0.0, image, touch, success=False, ended=False)
    return memory


def test_a_target_entropy_far_below_the_policys_lowers_the_temperature():
    phase = PhaseConfig(10, target_entropy=5.0, final_target_entropy=-50.0, entropy_steps=10)
    learner = make_learner(method="sac", sac=SacConfig(batch_size=4), task_phase=phase)
    memory = filled_replay()
    first, risen, last = (
        float(learner.update(memory, step)["temperature"]) for step in (0, 10, 10)
    )
    assert risen > first
    assert last < risen


@pytest.mark.parametrize("sense", SENSES)
@pytest.mark.parametrize("keypoints", [False, True])
def test_a_policy_that_learned_without_a_sense_ignores_it_everywhere(sense, keypoints):
    sac = SacConfig(batch_size=4, bfloat16=False)
    lacking = {"task_without": (sense,)} if keypoints else {"without": (sense,)}
    learner = make_learner(keypoints=keypoints, sac=sac, **lacking)
    memory = filled_replay()
    for step in range(3):
        learner.update(memory, step)
    policy = learner.actor()
    image = torch.randint(256, (2, 1, 84, 84), dtype=torch.uint8)
    touch = torch.rand(1, 11).repeat(2, 1)
    if sense != "vision":
        image[1] = image[0]
        touch[1, SENSED_TOUCH[sense]] += 1.0
    with torch.no_grad():
        first, second = policy(image, touch)
        torch.testing.assert_close(first, second, atol=1e-6, rtol=0)
        # It acts as in training, where the sense is constant.
        trained = mean_action(learner, image, touch)
    torch.testing.assert_close(policy(image, touch), torch.tanh(trained), atol=2e-3, rtol=0)
    if keypoints:
        return  # its batches have keypoints in place of the images
    batch = learner._batch(memory)
    if sense == "vision":
        other = replace(batch, next_image=255.0 - batch.next_image)
    else:
        other = replace(batch, next_touch=batch.next_touch.clone())
        other.next_touch[:, SENSED_TOUCH[sense]] += 1.0
    with torch.no_grad():
        errors = [learner.curiosity.errors(one) for one in (batch, other)]
    assert not torch.equal(*(one.surprise for one in errors))  # the curiosity has every sense


def test_a_blind_task_phase_stays_near_an_exploration_policy_that_sees(monkeypatch):
    def learn(keypoints, draw, updates):
        raise AssertionError("keypoints are learned where the picture is left out")

    monkeypatch.setattr(Keypoints, "learn", learn)
    learner = make_learner(keypoints=True, task_without=("forces", "vision"))
    image, touch = torch.randint(256, (3, 1, 84, 84), dtype=torch.uint8), torch.rand(3, 11)
    with torch.no_grad():
        kept = learner._features(image, touch)
        prior = learner.explorer.gaussian(image, learner.scale.scaled(touch))
        blind = learner.explorer.gaussian(torch.zeros_like(image), learner.scale.scaled(touch))
    assert (kept[:, :KEYPOINT_FEATURES] == 0).all()
    torch.testing.assert_close(kept[:, KEYPOINT_FEATURES:], prior)
    assert not torch.allclose(prior, blind)


@pytest.mark.parametrize(
    ("flags", "has"),
    [("", False), ("avx512_bf16", True), ("avx512_vnni", False), ("avx512_bf16 amx_bf16", True)],
)
def test_half_precision_needs_a_processor_that_has_it(monkeypatch, flags, has):
    monkeypatch.setattr(learners, "processor_flags", lambda: {*flags.split()})
    assert learners.has_bfloat16(torch.device("cpu")) == has


def test_the_workspace_spans_minus_one_to_one():
    workspace = Workspace((0.25, -0.2, 0.0), (0.7, 0.25, 0.04))
    scale = TouchScale.of(workspace, torch.device("cpu"))
    corners = torch.tensor([[*workspace.low, 0, 0, *[-10] * 6], [*workspace.high, 1, 1, *[10] * 6]])
    expected = torch.tensor([[-1.0] * 11, [1.0] * 11])
    torch.testing.assert_close(scale.scaled(corners), expected)
