"""Intrinsic curiosity module: features that the agent's actions change, predicted ahead."""

import torch
from torch import Tensor
from torch.nn import functional

from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.curiosity.curiosity import Curiosity, Errors, two_layers
from minitouch_bench.agents.replay import Batch
from minitouch_bench.policies.networks import FEATURES, TOUCH_SIZE, VisualEncoder


class InverseDynamics(Curiosity):
    """Predict the next features; learn the features by telling which action was done.

    r = mean_k (g(phi(x), a)_k - phi(x')_k)^2; phi learns through the inverse model
    a ~ h(phi(x), phi(x')) alone (Pathak et al. 2017, Burda et al. 2019: large-scale-curiosity).
    """

    uses_touch = False

    def __init__(self, config: CuriosityConfig, action_size: int) -> None:
        super().__init__(config)
        state = FEATURES + (TOUCH_SIZE if self.uses_touch else 0)
        self.encoder = VisualEncoder(config.width)
        self.inverse = two_layers(2 * FEATURES, action_size)
        self.forward_model = two_layers(state + action_size, state)

    def errors(self, batch: Batch) -> Errors:
        """Return the forward model's squared errors; the loss adds the inverse model's."""
        now = self.encode(self.encoder, batch.image)
        then = self.encode(self.encoder, batch.next_image)
        guessed = self.inverse(torch.cat((now, then), dim=1))
        inverse = functional.mse_loss(guessed, batch.action)
        surprise = self._forward_errors(batch, now.detach(), then.detach())
        return Errors(surprise, inverse + surprise.mean())

    def _forward_errors(self, batch: Batch, now: Tensor, then: Tensor) -> Tensor:
        if self.uses_touch:
            now = torch.cat((now, batch.touch), dim=1)
            then = torch.cat((then, batch.next_touch), dim=1)
        predicted = self.forward_model(torch.cat((now, batch.action), dim=1))
        errors: Tensor = (predicted - then).square().mean(dim=1)
        return errors


class TouchInverseDynamics(InverseDynamics):
    """The same with (phi(x), touch) as the state, so that the next touch is predicted as well.

    Source: the supplement's "touch in future prediction".
    """

    uses_touch = True
