"""Haptics-based curiosity: touch that an image does not predict (the paper's method)."""

import math

import torch
from torch import Tensor

from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.curiosity.curiosity import Curiosity, Errors, two_layers
from minitouch_bench.agents.replay import Batch
from minitouch_bench.policies.networks import FEATURES, TOUCH_SIZE, VisualEncoder
from minitouch_bench.simulation.observation import FORCES

LOG_VARIANCE_BOUNDS = (-4.6, 4.0)
"""Of a predicted force: its standard deviation stays above 0.1 of ``force_scale``, 1 N."""

MOST_SURPRISE = 25.0
"""Five standard deviations count as much as any more."""


class HapticCuriosity(Curiosity):
    """Predict the finger forces of the reached state from its image.

    r = mean_k (f_k(x') - h'_k)^2, where x' is the image and h' the forces of the reached
    state, both from the same moment (supplement, Figure 8: the agent "anticipates the
    force/torque sensation" of what it sees).

    Decisions, where the paper is silent:

    - Forces alone are predicted: position and opening are seen in every image.
    - ``haptics``: ``forces`` in units of ``force_scale``, or ``contact``, tanh |f| of each
      finger, which a hard press does not change any more.
    - ``standardize``: the spread s_k of each force is predicted too, by the likelihood of a
      normal distribution (Kendall and Gal 2017), and r = mean_k min((f_k - h'_k)^2 / s_k^2, 25):
      forces that are always random, as when the door is pressed, do not outweigh rare ones.
    - ``from_previous``: the prediction sees the image before the action, and the action.
    - The standard deviation is that of all surprises, which grow as the policy finds contacts.
    """

    window = math.inf

    def __init__(self, config: CuriosityConfig, action_size: int) -> None:
        super().__init__(config)
        self.encoder = VisualEncoder(config.width)
        inputs = FEATURES + (TOUCH_SIZE + action_size if config.from_previous else 0)
        outputs = 2 if config.haptics == "contact" else 6
        self.head = two_layers(inputs, 2 * outputs if config.standardize else outputs)

    def errors(self, batch: Batch) -> Errors:
        """Return squared errors, with ``standardize`` in units of the predicted variance.

        The loss is their mean, with ``standardize`` the negative log likelihood (less a constant).
        """
        prediction, haptics = self._prediction(batch), self.haptics(batch)
        if not self.config.standardize:
            surprise = (prediction - haptics).square().mean(dim=1)
            return Errors(surprise, surprise.mean())
        mean, log_variance = prediction.chunk(2, dim=1)
        log_variance = log_variance.clamp(*LOG_VARIANCE_BOUNDS)
        square = (mean - haptics).square() / log_variance.exp()
        loss = 0.5 * (square + log_variance).mean()
        return Errors(square.clamp(max=MOST_SURPRISE).mean(dim=1), loss)

    def haptics(self, batch: Batch) -> Tensor:
        """Return what is to be predicted, float32 (N, 6) or (N, 2)."""
        forces = batch.next_touch[:, FORCES]
        if self.config.haptics == "contact":
            return torch.tanh(forces.reshape(-1, 2, 3).norm(dim=2))
        return forces

    def _prediction(self, batch: Batch) -> Tensor:
        if self.config.from_previous:
            seen = self.encode(self.encoder, batch.image)
            seen = torch.cat((seen, batch.touch, batch.action), dim=1)
        else:
            seen = self.encode(self.encoder, batch.next_image)
        prediction: Tensor = self.head(seen)
        return prediction
