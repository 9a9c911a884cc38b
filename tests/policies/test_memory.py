"""Policies that remember: their episodes, and exports that lose what they remember."""

import contextlib
import importlib
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import minitouch_bench as mt
from minitouch_bench.evaluation.policy_setup import prepare_policies
from minitouch_bench.policies.formats import KIND_BY_SUFFIX
from minitouch_bench.policies.policy import Isolation, IsolationOptions, zero_observation
from minitouch_bench.runs.plan import make_plan
from tests.evaluation.runs import play_here
from tests.policies.conftest import load

pytestmark = pytest.mark.filterwarnings("ignore:`?torch.jit:DeprecationWarning")
EXAMPLES = Path(__file__).parents[2] / "docs" / "examples" / "policies"
FILES = {
    "script": "policy.pt", "trace": "policy.pt", "export": "policy.pt2", "onnx": "policy.onnx",
}  # fmt: skip
EXAMPLE = (torch.zeros(1, 1, 84, 84, dtype=torch.uint8), torch.ones(1, 11))


class Assigned(nn.Module):
    """A GRU cell whose state is assigned to a buffer."""

    def __init__(self) -> None:
        super().__init__()
        self.cell, self.head = nn.GRUCell(11, 8), nn.Linear(8, 5)
        self.register_buffer("state", torch.zeros(1, 8))

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        self.state = self.cell(touch, self.state)
        return torch.tanh(self.head(self.state))


class WrittenInPlace(Assigned):
    """A GRU cell whose state is written in place."""

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        self.state[:] = self.cell(touch, self.state)
        return torch.tanh(self.head(self.state))


class PlainState(Assigned):
    """A GRU cell whose state is not a buffer."""

    def __init__(self) -> None:
        super().__init__()
        del self.state
        self.state = torch.zeros(1, 8)


class Normalized(nn.Module):
    """No memory: the buffers of zeros are those of an untrained normalization."""

    def __init__(self) -> None:
        super().__init__()
        self.norm, self.head = nn.BatchNorm1d(11), nn.Linear(11, 5)

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        return torch.tanh(self.head(self.norm(touch)))


def export(module: nn.Module, how: str, path: Path) -> Path:
    module.eval()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporters' own, of states that are not buffers too
        if how == "export":
            torch.export.save(torch.export.export(module, EXAMPLE), path)
        elif how == "onnx":
            torch.onnx.export(
                module, EXAMPLE, path, input_names=["image", "touch"], output_names=["action"],
                external_data=False, dynamo=True,
            )  # fmt: skip
        else:
            with torch.no_grad():
                script = how == "script"
                kept = torch.jit.script(module) if script else torch.jit.trace(module, EXAMPLE)
            kept.save(str(path))
    return path


def notes_of(path: Path, isolation: Isolation = Isolation.SANDBOX) -> list[str]:
    notes: list[str] = []
    options = IsolationOptions(isolation, trust=isolation is Isolation.NONE)
    prepare_policies(str(path), make_plan("smoke"), options, notes.append)
    advised = [note for note in notes if note.startswith("TorchScript is deprecated")]
    assert len(advised) == (path.suffix == ".pt")
    return [note for note in notes if note not in advised]


def remembers(path: Path) -> bool:
    """Tell whether a policy answers the same observation differently the second time."""
    policy = load(KIND_BY_SUFFIX[path.suffix], path)
    observation = {**zero_observation(), "touch": np.ones(11, np.float32)}
    first, second = (policy.act(observation).tolist() for _ in range(2))
    return first != second


@pytest.mark.parametrize(
    ("how", "module", "keeps", "named"),
    [
        ("script", Assigned, True, None),
        ("trace", WrittenInPlace, True, None),
        ("export", WrittenInPlace, True, None),
        ("trace", Assigned, False, "GRUCell"),
        ("export", PlainState, False, "GRUCell"),
        ("onnx", Assigned, False, "GRUCell"),
        ("trace", Normalized, False, None),
        ("export", Normalized, False, None),
        ("onnx", Normalized, False, None),
    ],
)
def test_an_export_that_lost_its_state_is_warned_about_and_no_other(
    how, module, keeps, named, tmp_path
):
    if how == "onnx":
        pytest.importorskip("onnxscript")
    path = export(module(), how, tmp_path / FILES[how])
    assert remembers(path) is keeps
    notes = notes_of(path, Isolation.NONE if module is PlainState else Isolation.SANDBOX)
    assert len(notes) == (named is not None)
    assert all(named in note and "torch.export" in note for note in notes)


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    """The examples' modules by name, and the directory with the files that they wrote."""
    directory = tmp_path_factory.mktemp("examples")
    torch.manual_seed(4)
    with contextlib.chdir(directory), pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(EXAMPLES)
        modules = [importlib.import_module(file.stem) for file in EXAMPLES.glob("*.py")]
    return {module.__name__: module.policy for module in modules}, directory


def digest_of(policy):
    run = mt.evaluate(policy, "smoke", tasks=["pushing"], episodes=2)
    assert not run.faults
    return run.digest


@pytest.mark.parametrize("name", ["recurrent", "frame_stack"])
def test_the_files_of_an_example_play_the_episodes_of_its_module(examples, name, monkeypatch):
    play_here(monkeypatch, steps=20)
    modules, directory = examples
    wanted = digest_of(modules[name])
    files = sorted(directory.glob(f"{name}.*"))
    assert {digest_of(str(file)) for file in files} == {wanted}
    if name == "recurrent":
        assert [file.suffix for file in files] == [".pt", ".pt2"]


@pytest.mark.parametrize("layer", [nn.Dropout(0.5), nn.BatchNorm2d(1)])
def test_an_export_in_training_mode_is_warned_about(layer, tmp_path):
    class Trained(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.batch_norm, self.head = layer, nn.Linear(11, 5)

        def forward(self, image: Tensor, touch: Tensor) -> Tensor:
            return torch.tanh(self.head(touch) + self.batch_norm(image.float()).mean())

    module = Trained().train()
    torch.export.save(torch.export.export(module, EXAMPLE), tmp_path / "train.pt2")
    (note,) = notes_of(tmp_path / "train.pt2")
    assert "eval()" in note
    assert notes_of(export(module, "export", tmp_path / "policy.pt2")) == []
