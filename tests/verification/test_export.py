"""What ``mt.export`` writes acts like the module; what would not is not written."""

import pytest
import torch
from torch import Tensor, nn

import minitouch_bench as mt
from tests.policies.test_memory import Assigned, PlainState, WrittenInPlace


class Frames(nn.Module):
    """The last three touch vectors, in a list."""

    def __init__(self) -> None:
        super().__init__()
        self.head, self.frames = nn.Linear(33, 5), [torch.zeros(1, 11)] * 3

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        self.frames = [*self.frames[1:], touch]
        return torch.tanh(self.head(torch.cat(self.frames, 1)))


class Exits(nn.Module):
    """Ends the program."""

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        raise SystemExit


class Inside(nn.Module):
    """A policy that remembers by a part of it, has dropout and draws random numbers."""

    def __init__(self, part: nn.Module) -> None:
        super().__init__()
        self.part, self.dropout = part, nn.Dropout(0.5)

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        return self.dropout(self.part(image, touch)) + 0.01 * torch.randn(1, 5)


def test_a_module_that_keeps_its_state_is_written_and_left_as_it_is(tmp_path):
    torch.manual_seed(1)
    module = Inside(WrittenInPlace()).train()
    before = torch.get_rng_state(), torch.get_num_threads()
    said = mt.export(module, tmp_path / "policy.pt2", task="opening")
    assert module.training
    assert not module.part.state.any()
    assert torch.equal(torch.get_rng_state(), before[0])
    assert torch.get_num_threads() == before[1]
    run = mt.evaluate(str(tmp_path / "policy.pt2"), "smoke", tasks=["opening"], episodes=1)
    assert run.episodes["steps"].tolist() == [said.actions]
    assert said.difference < 1e-6
    assert f"{said.actions} actions of an episode of opening" in str(said)


@pytest.mark.parametrize(
    ("module", "named"),
    [
        (Frames(), "frames (list)"),
        (PlainState(), "state (Tensor)"),
        (Inside(Assigned()), "part.state (Tensor)"),
    ],
)
def test_a_lost_state_is_named_and_nothing_written(module, named, tmp_path):
    path = tmp_path / "policy.pt2"
    with pytest.raises(mt.MiniTouchError) as refused:
        mt.export(module, path, task="pushing")
    assert f"lost {named}:" in str(refused.value)
    assert "from action 2 " in str(refused.value)
    assert not path.exists()


@pytest.mark.filterwarnings("ignore:`?torch.jit:DeprecationWarning")
@pytest.mark.parametrize(
    ("make", "file", "word"),
    [
        (lambda: torch.jit.script(nn.Identity()), "policy.pt2", "nn.Module"),
        (Frames, "policy.pt", "pt2"),
        (nn.Identity, "policy.pt2", "torch.export"),
        (Exits, "policy.pt2", "SystemExit"),
    ],
)
def test_what_cannot_be_exported_is_refused(make, file, word, tmp_path):
    with pytest.raises(mt.MiniTouchError, match=word):
        mt.export(make(), tmp_path / file, task="pushing")
