"""Policies that remember: exports that lose what they remember are warned about."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from minitouch_bench.evaluation.policy_setup import prepare_policies
from minitouch_bench.policies.policy import Isolation, IsolationOptions, zero_observation
from minitouch_bench.policies.process import isolate
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.runs.plan import make_plan

pytestmark = pytest.mark.filterwarnings("ignore:`?torch.jit:DeprecationWarning")
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


class Stack(nn.Module):
    """The last four touch vectors."""

    def __init__(self) -> None:
        super().__init__()
        self.head = nn.Linear(44, 5)
        self.register_buffer("frames", torch.zeros(4, 11))

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        self.frames = torch.cat((self.frames[1:], touch))
        return torch.tanh(self.head(self.frames.flatten()[None]))


class Normalized(nn.Module):
    """No memory: the buffers of zeros are those of an untrained normalization."""

    def __init__(self) -> None:
        super().__init__()
        self.norm, self.head = nn.BatchNorm1d(11), nn.Linear(11, 5)

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        return torch.tanh(self.head(self.norm(touch)))


def export(module: nn.Module, how: str, path: Path) -> Path:
    module.eval()
    if how == "onnx":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the exporter's own
            torch.onnx.export(
                module, EXAMPLE, path, input_names=["image", "touch"], output_names=["action"],
                external_data=False, dynamo=True,
            )  # fmt: skip
        return path
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore", torch.jit.TracerWarning)
        kept = torch.jit.script(module) if how == "script" else torch.jit.trace(module, EXAMPLE)
    kept.save(str(path))
    return path


def notes_of(path: Path, isolation: Isolation = Isolation.SANDBOX) -> list[str]:
    notes: list[str] = []
    options = IsolationOptions(isolation, trust=isolation is Isolation.NONE)
    prepare_policies(str(path), make_plan("smoke"), options, notes.append)
    return notes


def remembers(path: Path) -> bool:
    """Tell whether a policy answers the same observation differently the second time."""
    policy = isolate(parse_source(str(path)))
    policy.reset(0, "opening")
    observation = {**zero_observation(), "touch": np.ones(11, np.float32)}
    first, second = (policy.act(observation).tolist() for _ in range(2))
    policy.close()
    return first != second


@pytest.mark.parametrize("module", [Assigned, WrittenInPlace, Stack])
def test_a_script_keeps_its_state_and_is_not_warned_about(module, tmp_path):
    path = export(module(), "script", tmp_path / "policy.pt")
    assert remembers(path)
    assert notes_of(path) == []


@pytest.mark.parametrize(("module", "named"), [(Assigned, "GRUCell"), (Stack, "'frames'")])
@pytest.mark.parametrize("isolation", [Isolation.SANDBOX, Isolation.NONE])
def test_a_trace_that_lost_its_state_is_warned_about(module, named, isolation, tmp_path):
    path = export(module(), "trace", tmp_path / "policy.pt")
    assert not remembers(path)
    (note,) = notes_of(path, isolation)
    assert named in note
    assert "torch.jit.script" in note


def test_a_trace_that_writes_in_place_keeps_its_state(tmp_path):
    path = export(WrittenInPlace(), "trace", tmp_path / "policy.pt")
    assert remembers(path)
    assert notes_of(path) == []


def test_a_trace_without_memory_is_not_warned_about(tmp_path):
    assert notes_of(export(Normalized(), "trace", tmp_path / "policy.pt")) == []


def test_a_recurrent_onnx_graph_is_warned_about(tmp_path):
    pytest.importorskip("onnxscript")
    (note,) = notes_of(export(Assigned(), "onnx", tmp_path / "policy.onnx"))
    assert "GRUCell" in note
    assert notes_of(export(Normalized(), "onnx", tmp_path / "plain.onnx")) == []
