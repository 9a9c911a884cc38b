"""What every curiosity is: a model that learns from batches, and a reward from its surprise."""

from abc import ABC, abstractmethod
from typing import Any

import torch
from torch import Tensor, nn

from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.encoding import encode
from minitouch_bench.agents.replay import Batch
from minitouch_bench.policies.networks import HIDDEN_UNITS, VisualEncoder


class Curiosity(nn.Module, ABC):
    """What an agent has learned from, paid where a transition is new to it.

    A subclass says how it learns (``update``) and what surprise is (``surprise``). What it
    learns is a parameter or a buffer, so that checkpoints hold it. Batches are one control
    step long and hold normalized touch.
    """

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
        """Get ready to learn, once everything is in place on its device."""

    @abstractmethod
    def update(self, batch: Batch) -> dict[str, Tensor]:
        """Learn from a batch and return what is worth a curve, by name."""

    @abstractmethod
    def surprise(self, batch: Batch) -> Tensor:
        """Return how new each transition is, float32 (N,), >= 0."""

    @torch.no_grad()
    def reward(self, batch: Batch) -> Tensor:
        """Return the intrinsic reward of each transition, float32 (N,).

        With ``normalize`` it is divided by the running standard deviation of all surprises.
        """
        surprise = self.surprise(batch)
        if not self.config.normalize:
            return surprise
        self._count(surprise.double())
        deviation = (self.squares / self.seen).sqrt().float()
        return surprise / (deviation + 1e-8)

    def _count(self, values: Tensor) -> None:
        """Add values to the running mean and variance (Chan et al.)."""
        count = len(values)
        total = self.seen + count
        delta = values.mean() - self.mean
        self.squares += values.var(correction=0) * count + delta**2 * self.seen * count / total
        self.mean += delta * count / total
        self.seen += count

    def state(self) -> dict[str, Any]:
        """Return everything that later steps depend on."""
        return {"curiosity": self.state_dict()}

    def load_state(self, state: dict[str, Any]) -> None:
        """Go on from what ``state`` returned; other keys are left alone."""
        self.load_state_dict(state["curiosity"])


class Predictor(Curiosity):
    """Networks that predict something of the world, paid where they are wrong.

    A subclass says what they are to learn (``loss``) and where they are wrong (``surprise``).
    """

    optimizer: torch.optim.Optimizer

    def begin(self) -> None:
        """Make the optimizer."""
        trained = [one for one in self.parameters() if one.requires_grad]
        self.optimizer = torch.optim.Adam(trained, self.config.learning_rate, fused=True)

    @abstractmethod
    def loss(self, batch: Batch) -> Tensor:
        """Return the networks' loss, a scalar."""

    def update(self, batch: Batch) -> dict[str, Tensor]:
        """Do one gradient step and return the loss."""
        loss = self.loss(batch)
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()
        return {"curiosity_loss": loss.detach()}

    def state(self) -> dict[str, Any]:
        """Return everything that later steps depend on."""
        return super().state() | {"curiosity_optimizer": self.optimizer.state_dict()}

    def load_state(self, state: dict[str, Any]) -> None:
        """Go on from what ``state`` returned; other keys are left alone."""
        super().load_state(state)
        self.optimizer.load_state_dict(state["curiosity_optimizer"])

    def encode(self, encoder: nn.Module, image: Tensor) -> Tensor:
        """Return features of pictures, float32 (N, F)."""
        return encode(encoder, image, bfloat16=self.config.bfloat16)


def own_encoder(config: CuriosityConfig) -> VisualEncoder:
    """Return an encoder as Table 3's, of the configured width."""
    return VisualEncoder(config.width)


def two_layers(inputs: int, outputs: int) -> nn.Sequential:
    """Return a head with two hidden layers of 128 units (supplement, Table 2)."""
    return nn.Sequential(
        nn.Linear(inputs, HIDDEN_UNITS),
        nn.LeakyReLU(),
        nn.Linear(HIDDEN_UNITS, HIDDEN_UNITS),
        nn.LeakyReLU(),
        nn.Linear(HIDDEN_UNITS, outputs),
    )
