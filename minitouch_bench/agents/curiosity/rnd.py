"""Random network distillation: what looks unlike anything learned from yet."""

import torch
from torch import Tensor, nn

from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.curiosity.curiosity import (
    Curiosity,
    Errors,
    Whitening,
    initialize,
)
from minitouch_bench.agents.replay import Batch
from minitouch_bench.policies.networks import TOUCH_SIZE, ImageConvolutions
from minitouch_bench.policies.policy import IMAGE_SHAPE

OUTPUTS = 512
"""Numbers that the target network gives (Burda et al. 2019)."""


class RandomDistillation(Curiosity):
    """Predict what a fixed random network says of the reached state.

    r = mean_k (f(o')_k - t(o')_k)^2, t random and fixed, o' the whitened image (Burda et
    al. 2019). Convolutions of 32, 64 and 64 channels as theirs, times ``width``; the predictor
    is two layers deeper. It does not depend on actions.
    """

    uses_touch = False

    def __init__(self, config: CuriosityConfig, _action_size: int) -> None:
        super().__init__(config)
        self.target_maps = _convolutions(config.width).requires_grad_(False)
        flat = self.target_maps(torch.zeros(1, *IMAGE_SHAPE)).shape[1]
        inputs = flat + (TOUCH_SIZE if self.uses_touch else 0)
        self.target_head = self._target_head(inputs).requires_grad_(False)
        self.maps = _convolutions(config.width)
        self.hidden = nn.Sequential(
            nn.Linear(inputs, OUTPUTS), nn.ReLU(), nn.Linear(OUTPUTS, OUTPUTS), nn.ReLU()
        )
        self.head = nn.Linear(OUTPUTS, OUTPUTS)
        self.whitening = Whitening()
        self.apply(initialize)

    @staticmethod
    def _target_head(inputs: int) -> nn.Module:
        return nn.Linear(inputs, OUTPUTS)

    def errors(self, batch: Batch) -> Errors:
        """Learn the pixels' statistics, and return the predictor's squared errors."""
        self.whitening.watch(batch.next_image)
        image = self.whitening(batch.next_image)
        target: Tensor = self.target_head(self._seen(self.target_maps, image, batch.next_touch))
        seen = self._seen(self.maps, image, batch.next_touch)
        guess: Tensor = self.head(self.encode(self.hidden, seen))
        surprise = (guess - target).square().mean(dim=1)
        return Errors(surprise, surprise.mean())

    def _seen(self, maps: nn.Module, image: Tensor, touch: Tensor) -> Tensor:
        features = self.encode(maps, image)
        if not self.uses_touch:
            return features
        weight = (features.shape[1] / TOUCH_SIZE) ** 0.5
        return torch.cat((features, weight * touch), dim=1)


class TouchDistillation(RandomDistillation):
    """The same on image features and touch, concatenated as the input of both networks.

    The supplement (7.5) says no more. Ours: touch is multiplied by sqrt(features / touch numbers),
    so that the few numbers change the target about as much as the many features do. The target
    has a hidden layer after them: without it touch would be mapped linearly, and new touch hardly
    be new.
    """

    uses_touch = True

    @staticmethod
    def _target_head(inputs: int) -> nn.Module:
        return nn.Sequential(nn.Linear(inputs, OUTPUTS), nn.ReLU(), nn.Linear(OUTPUTS, OUTPUTS))


def _convolutions(width: float) -> ImageConvolutions:
    first, second, third = (max(1, int(width * channels)) for channels in (32, 64, 64))
    return ImageConvolutions(
        nn.Conv2d(1, first, 8, 4), nn.LeakyReLU(),
        nn.Conv2d(first, second, 4, 2), nn.LeakyReLU(),
        nn.Conv2d(second, third, 3, 1), nn.LeakyReLU(),
        nn.Flatten(),
    )  # fmt: skip
