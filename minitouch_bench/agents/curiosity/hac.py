"""Haptics-based curiosity: the touch that a picture does not let expect (the paper's method)."""

import torch
from torch import Tensor, nn

from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.curiosity.curiosity import Predictor, own_encoder, two_layers
from minitouch_bench.agents.replay import Batch
from minitouch_bench.policies.networks import FEATURES, TOUCH_SIZE
from minitouch_bench.simulation.observation import FORCES


class HapticCuriosity(Predictor):
    """Predict the finger forces of the reached state from its picture.

    r = mean_k (f_k(x') - h'_k)^2, where x' is the picture and h' the forces of the reached
    state, both from the same moment (supplement, Figure 8: the agent "anticipates the
    force/torque sensation" of what it sees).

    Decisions, where the paper is silent:

    - Forces alone are predicted: position and opening are seen in every picture.
    - ``haptics``: ``forces`` in units of ``force_scale``; ``compressed``, asinh of each
      component; ``magnitude``, log(1 + |f|) of each finger, whose sign cannot flip;
      ``contact``, tanh |f| of each finger, which a hard press does not change any more.
    - ``members`` > 1: an ensemble; r is the variance of its predictions, which falls to 0
      where more data teach nothing more (as in Pathak et al. 2019).
    - ``from_previous``: the prediction sees the picture before the action, and the action.
    """

    def __init__(self, config: CuriosityConfig, action_size: int) -> None:
        super().__init__(config)
        self.encoder = own_encoder(config)
        outputs = 2 if config.haptics in ("magnitude", "contact") else 6
        inputs = FEATURES + (TOUCH_SIZE + action_size if config.from_previous else 0)
        self.heads = nn.ModuleList(two_layers(inputs, outputs) for _ in range(config.members))

    def loss(self, batch: Batch) -> Tensor:
        """Return the mean squared error of every member."""
        return (self._predictions(batch) - self.haptics(batch)).square().mean()

    def surprise(self, batch: Batch) -> Tensor:
        """Return the squared error, or of an ensemble the variance of its predictions."""
        predictions = self._predictions(batch)
        if len(self.heads) > 1:
            return predictions.var(dim=0, correction=0).mean(dim=1)
        return (predictions[0] - self.haptics(batch)).square().mean(dim=1)

    def haptics(self, batch: Batch) -> Tensor:
        """Return what is to be predicted, float32 (N, 6) or (N, 2)."""
        forces = batch.next_touch[:, FORCES]
        match self.config.haptics:
            case "compressed":
                return torch.asinh(forces)
            case "magnitude":
                return torch.log1p(forces.reshape(-1, 2, 3).norm(dim=2))
            case "contact":
                return torch.tanh(forces.reshape(-1, 2, 3).norm(dim=2))
        return forces

    def _predictions(self, batch: Batch) -> Tensor:
        """Return every member's prediction, float32 (members, N, 6 or 2)."""
        if self.config.from_previous:
            seen = self.encode(self.encoder, batch.image)
            seen = torch.cat((seen, batch.touch, batch.action), dim=1)
        else:
            seen = self.encode(self.encoder, batch.next_image)
        return torch.stack([head(seen) for head in self.heads])
