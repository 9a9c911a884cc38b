"""What every curiosity is: a model that learns from batches, and a reward from its surprise."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.encoding import encode
from minitouch_bench.agents.replay import Batch
from minitouch_bench.policies.networks import HIDDEN_UNITS
from minitouch_bench.policies.policy import IMAGE_SHAPE

WHITENED_LIMIT = 5.0
"""Standard deviations."""


@dataclass(frozen=True)
class Errors:
    """What a model got wrong about a batch, before it learned from it.

    ``surprise`` float32 (N,), >= 0: how new each transition is. ``loss``: a scalar.
    """

    surprise: Tensor
    loss: Tensor


class Curiosity(nn.Module, ABC):
    """What an agent has learned from, paid where a transition is new to it.

    A subclass says what surprises it (``errors``), and there updates what it learns without
    gradients. What it learns is a parameter or a buffer, so that checkpoints hold it. Batches are
    one control step long and hold normalized touch.

    The reward comes from the same pass as the loss, so from the weights before the gradient step:
    another pass costs as much again as the loss, and one gradient step changes it little.

    ``window``: over how many batches, the latest ones, the rewards' standard deviation is taken.
    A model's first surprises can be a thousand times its later ones: were they never forgotten,
    the reward would stay near 0.
    """

    window: ClassVar[float] = 100

    def __init__(self, config: CuriosityConfig) -> None:
        super().__init__()
        self.config = config
        self.seen: Tensor
        self.mean: Tensor
        self.squares: Tensor
        self.register_buffer("seen", torch.zeros((), dtype=torch.float64))
        self.register_buffer("mean", torch.zeros((), dtype=torch.float64))
        self.register_buffer("squares", torch.zeros((), dtype=torch.float64))

    def begin(self) -> None:
        """Make the optimizer, once everything is in place on its device."""
        # As a group, which may be empty: a model need not have a network.
        trained = {"params": [weights for weights in self.parameters() if weights.requires_grad]}
        self.optimizer = torch.optim.Adam([trained], self.config.learning_rate, fused=True)

    @abstractmethod
    def errors(self, batch: Batch) -> Errors:
        """Return how new each transition is, and the networks' loss with its gradients."""

    def update(self, batch: Batch) -> Errors:
        """Learn from a batch, by one gradient step, and return the errors before it."""
        errors = self.errors(batch)
        if errors.loss.requires_grad:
            self.optimizer.zero_grad()
            errors.loss.backward()  # type: ignore[no-untyped-call]
            self.optimizer.step()
        return Errors(errors.surprise.detach(), errors.loss.detach())

    @torch.no_grad()
    def reward(self, surprise: Tensor) -> Tensor:
        """Return the intrinsic reward of transitions, float32 (N,), from how new they are.

        With ``normalize`` it is divided by the standard deviation of about the last ``window``
        batches of surprises.
        """
        if not self.config.normalize:
            return surprise
        self._count(surprise.double())
        deviation = (self.squares / self.seen).sqrt().float()
        return surprise / (deviation + 1e-8)

    def _count(self, values: Tensor) -> None:
        """Add values to the running mean and variance (Chan et al.), and forget the oldest."""
        count = len(values)
        total = self.seen + count
        delta = values.mean() - self.mean
        self.squares += values.var(correction=0) * count + delta**2 * self.seen * count / total
        self.mean += delta * count / total
        self.seen += count
        kept = torch.clamp(self.window * count / self.seen, max=1.0)
        self.squares *= kept
        self.seen *= kept

    def state(self) -> dict[str, Any]:
        """Return everything that later steps depend on."""
        optimizer = self.optimizer.state_dict()
        return {"curiosity": self.state_dict(), "curiosity_optimizer": optimizer}

    def load_state(self, state: dict[str, Any]) -> None:
        """Go on from what ``state`` returned; other keys are left alone."""
        self.load_state_dict(state["curiosity"])
        self.optimizer.load_state_dict(state["curiosity_optimizer"])

    def encode(self, encoder: nn.Module, image: Tensor) -> Tensor:
        """Return features of images, float32 (N, F)."""
        return encode(encoder, image, bfloat16=self.config.bfloat16)


class Whitening(nn.Module):
    """Subtract each pixel's mean over all images seen, and divide by its standard deviation.

    The result is clipped to WHITENED_LIMIT (Burda et al. 2019). A random network tells images
    apart that it sees so; of raw ones it sees the background, which is the same in all.
    """

    def __init__(self) -> None:
        super().__init__()
        self.count: Tensor
        self.mean: Tensor
        self.square: Tensor
        self.register_buffer("count", torch.zeros(()))
        self.register_buffer("mean", torch.zeros(IMAGE_SHAPE))
        self.register_buffer("square", torch.zeros(IMAGE_SHAPE))

    @torch.no_grad()
    def watch(self, images: Tensor) -> None:
        """Add a batch, uint8 (N, 1, H, W), to the running mean and mean square of each pixel."""
        gray = images.float()
        self.count += len(gray)
        rate = len(gray) / self.count
        self.mean += rate * (gray.mean(dim=0) - self.mean)
        self.square += rate * (gray.square().mean(dim=0) - self.square)

    def forward(self, images: Tensor) -> Tensor:
        """Return whitened images, float32 (N, 1, H, W)."""
        variance = (self.square - self.mean.square()).clamp_min(1.0)
        whitened = (images.float() - self.mean) / variance.sqrt()
        return whitened.clamp(-WHITENED_LIMIT, WHITENED_LIMIT)


def initialize(module: nn.Module) -> None:
    """Give a layer orthogonal weights of gain sqrt(2) and no bias (Burda et al. 2019)."""
    if isinstance(module, nn.Conv2d | nn.Linear):
        nn.init.orthogonal_(module.weight, math.sqrt(2.0))
        assert module.bias is not None
        nn.init.zeros_(module.bias)


def two_layers(inputs: int, outputs: int) -> nn.Sequential:
    """Return a head with two hidden layers of 128 units (supplement, Table 2)."""
    return nn.Sequential(
        nn.Linear(inputs, HIDDEN_UNITS),
        nn.LeakyReLU(),
        nn.Linear(HIDDEN_UNITS, HIDDEN_UNITS),
        nn.LeakyReLU(),
        nn.Linear(HIDDEN_UNITS, outputs),
    )
