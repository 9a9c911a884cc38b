"""One actor trained with stock Stable-Baselines3, handed in as zip, TorchScript and ONNX."""

import json
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import SAC

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]

TRAINING_STEPS = 300


class ExportedActor(torch.nn.Module):
    """The deterministic actor of an SB3 model, in the form the harness takes."""

    def __init__(self, model):
        super().__init__()
        self.actor = model.policy.actor

    def forward(self, image, touch):
        features = self.actor.features_extractor({"image": image.float() / 255.0, "touch": touch})
        squashed = torch.tanh(self.actor.mu(self.actor.latent_pi(features)))
        # SB3 maps the tanh onto the action space, here [-1, 1], which rounds its last bit.
        return -1.0 + 0.5 * (squashed + 1.0) * 2.0


@pytest.fixture(scope="module")
def exports(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exports")
    environment = gymnasium.make("minitouch_bench:MiniTouch/Pushing-v1")
    model = SAC(
        "MultiInputPolicy",
        environment,
        buffer_size=1000,
        learning_starts=100,
        batch_size=32,
        seed=0,
    )
    model.learn(TRAINING_STEPS)
    model.save(folder / "actor.zip")
    actor = ExportedActor(model).eval()
    example = (torch.zeros(1, 1, 84, 84, dtype=torch.uint8), torch.zeros(1, 11))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch's exporters warn about themselves
        torch.jit.trace(actor, example).save(folder / "actor.pt")
        torch.onnx.export(
            actor, example, folder / "actor.onnx", input_names=["image", "touch"],
            output_names=["action"], external_data=False,
        )  # fmt: skip
    return folder


def evaluate(folder, suffix):
    subprocess.run(
        [sys.executable, "-m", "minitouch_bench", "evaluate", f"actor{suffix}",
         "--tasks", "pushing", "--episodes", "4", "--output", f"run{suffix}"],
        cwd=folder, check=True, capture_output=True,
    )  # fmt: skip
    document = json.loads((folder / f"run{suffix}" / "run.json").read_text())
    with np.load(folder / f"run{suffix}" / "actions.npz") as archive:
        return document["summary"], {key: archive[key] for key in archive.files}


@pytest.fixture(scope="module")
def runs(exports):
    return {suffix: evaluate(exports, suffix) for suffix in (".zip", ".pt", ".onnx")}


def test_zip_and_torchscript_are_the_same_bits(runs):
    (summary, actions), (other, other_actions) = runs[".zip"], runs[".pt"]
    assert summary == other
    assert all(np.array_equal(actions[key], other_actions[key]) for key in actions)


def test_onnx_differs_by_rounding_alone(runs):
    (summary, actions), (other, other_actions) = runs[".zip"], runs[".onnx"]
    for key, applied in actions.items():
        assert np.allclose(applied[0], other_actions[key][0], atol=1e-6)
    # Contact amplifies a last bit, so it is the outcome that must agree, not every tick.
    first, second = (run["tasks"][0]["estimates"]["success"]["value"] for run in (summary, other))
    assert first == second
