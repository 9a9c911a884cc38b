"""TorchScript modules that do what a policy must not; saved by a test, never run in it."""

import io
import warnings

import torch
from torch import Tensor, nn


class Loops(nn.Module):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        while bool(touch.isfinite().all()):
            touch = touch * 0
        return touch[:, :4]


class Floods(nn.Module):
    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        for _ in range(1_000_000_000):
            print("x", touch)
        return touch[:, :4]


class Mutates(nn.Module):
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
