"""Disagreement of an ensemble about what comes next."""

import torch
from torch import nn

from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.curiosity.curiosity import (
    Curiosity,
    Errors,
    Whitening,
    initialize,
    two_layers,
)
from minitouch_bench.agents.replay import Batch
from minitouch_bench.policies.networks import FEATURES, VisualEncoder

MEMBERS = 5
"""Models in the ensemble (Pathak et al. 2019)."""


class Disagreement(Curiosity):
    """Predict the next features with five models; pay where they differ.

    r = mean_k var_m g_m(phi(x), a)_k (Pathak et al. 2019, exploration-by-disagreement).
    phi is a random encoder of whitened images that is never trained: their simplest choice.
    """

    def __init__(self, config: CuriosityConfig, action_size: int) -> None:
        super().__init__(config)
        self.whitening = Whitening()
        self.encoder = VisualEncoder(config.width).apply(initialize).requires_grad_(False)
        self.members = nn.ModuleList(
            two_layers(FEATURES + action_size, FEATURES) for _ in range(MEMBERS)
        )

    def errors(self, batch: Batch) -> Errors:
        """Return the variance of the predictions; the loss is every member's squared error."""
        self.whitening.watch(batch.next_image)
        now, then = (
            self.encode(self.encoder, self.whitening(image))
            for image in (batch.image, batch.next_image)
        )
        seen = torch.cat((now, batch.action), dim=1)
        predictions = torch.stack([member(seen) for member in self.members])
        variance = predictions.detach().var(dim=0, correction=0)
        return Errors(variance.mean(dim=1), (predictions - then).square().mean())
