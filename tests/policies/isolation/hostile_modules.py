"""TorchScript modules that do what a policy must not; saved by a test, never run in it."""

import io
import warnings

import torch
from torch import Tensor, nn


class Hostile(nn.Module):
    def __init__(self, path: str) -> None:
        super().__init__()
        self.path = path
        self.count = 0


class WritesAtLoad(Hostile):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        return touch[:, :4]

    @torch.jit.export
    def __getstate__(self) -> tuple[str, bool]:
        return self.path, self.training

    @torch.jit.export
    def __setstate__(self, state: tuple[str, bool]) -> None:
        self.path = state[0]
        self.training = state[1]
        self.count = 0
        torch.save(torch.zeros(1), self.path)


class ReadsInAct(Hostile):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        return torch.from_file(self.path, False, 4, dtype=torch.uint8).float()[None]


class WritesInAct(Hostile):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        torch.save(touch, self.path)
        return touch[:, :4]


class Maps(Hostile):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        return torch.from_file(self.path, True, 4, dtype=torch.float)[None]


class Loops(Hostile):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        while bool(touch.isfinite().all()):
            touch = touch * 0
        return touch[:, :4]


class Allocates(Hostile):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        return torch.zeros([2_500_000_000])[:4][None]


class Floods(Hostile):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        for _ in range(1_000_000_000):
            print("x", touch)
        return touch[:, :4]


class Forks(Hostile):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        return torch.jit.wait(torch.jit.fork(torch.relu, touch))[:, :4]


class Counts(Hostile):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        self.count += 1
        return torch.full([1, 4], float(self.count))


class Mutates(Hostile):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        seen = touch[:, :4].clone()
        image.zero_()
        touch.fill_(9.0)
        return seen


def saved(module: nn.Module) -> bytes:
    """Return a module's TorchScript file."""
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.save(torch.jit.script(module), buffer)
    return buffer.getvalue()
