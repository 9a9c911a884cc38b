"""Random network distillation: what looks unlike anything learned from yet."""

import torch
from torch import Tensor, nn

from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.curiosity.curiosity import Predictor
from minitouch_bench.agents.replay import Batch
from minitouch_bench.policies.networks import TOUCH_SIZE, FirstConvolution
from minitouch_bench.policies.policy import IMAGE_SHAPE

OUTPUTS = 512
"""Numbers that the target network gives (Burda et al. 2019)."""
WHITENED_LIMIT = 5.0
"""Whitened pixels are clipped to this (Burda et al. 2019)."""


class RandomDistillation(Predictor):
    """Predict what a fixed random network says of the reached state.

    r = mean_k (f(o')_k - t(o')_k)^2, t random and fixed, o' the whitened picture (Burda et
    al. 2019). Convolutions of 32, 64 and 64 channels as theirs; the predictor is two layers
    deeper. It does not depend on actions.
    """

    uses_touch = False

    def __init__(self, config: CuriosityConfig, _action_size: int) -> None:
        super().__init__(config)
        flat = _convolutions()(torch.zeros(1, *IMAGE_SHAPE)).shape[1]
        inputs = flat + (TOUCH_SIZE if self.uses_touch else 0)
        self.target_maps = _convolutions().requires_grad_(False)
        self.target_head = nn.Linear(inputs, OUTPUTS).requires_grad_(False)
        self.maps = _convolutions()
        self.head = nn.Sequential(
            nn.Linear(inputs, OUTPUTS), nn.ReLU(),
            nn.Linear(OUTPUTS, OUTPUTS), nn.ReLU(),
            nn.Linear(OUTPUTS, OUTPUTS),
        )  # fmt: skip
        self.pictures: Tensor
        self.pixel_mean: Tensor
        self.pixel_square: Tensor
        self.register_buffer("pictures", torch.zeros(()))
        self.register_buffer("pixel_mean", torch.zeros(IMAGE_SHAPE))
        self.register_buffer("pixel_square", torch.zeros(IMAGE_SHAPE))

    def loss(self, batch: Batch) -> Tensor:
        """Learn the pixels' statistics, and return the predictor's mean squared error."""
        self._watch(batch.next_image.float())
        return self.surprise(batch).mean()

    def surprise(self, batch: Batch) -> Tensor:
        """Return the predictor's squared error."""
        image = self._whitened(batch.next_image.float())
        target = self._output(self.target_maps, self.target_head, image, batch.next_touch)
        guess = self._output(self.maps, self.head, image, batch.next_touch)
        return (guess - target.detach()).square().mean(dim=1)

    def _output(self, maps: nn.Module, head: nn.Module, image: Tensor, touch: Tensor) -> Tensor:
        features = self.encode(maps, image)
        seen = torch.cat((features, touch), dim=1) if self.uses_touch else features
        output: Tensor = head(seen)
        return output

    @torch.no_grad()
    def _watch(self, images: Tensor) -> None:
        """Add a batch to the running mean and mean square of each pixel."""
        self.pictures += len(images)
        rate = len(images) / self.pictures
        self.pixel_mean += rate * (images.mean(dim=0) - self.pixel_mean)
        self.pixel_square += rate * (images.square().mean(dim=0) - self.pixel_square)

    def _whitened(self, images: Tensor) -> Tensor:
        variance = (self.pixel_square - self.pixel_mean.square()).clamp_min(1.0)
        whitened = (images - self.pixel_mean) / variance.sqrt()
        return whitened.clamp(-WHITENED_LIMIT, WHITENED_LIMIT)


class TouchDistillation(RandomDistillation):
    """The same on picture and touch, concatenated before the last layers of both networks.

    Source: supplement, 7.5.
    """

    uses_touch = True


def _convolutions() -> nn.Sequential:
    return nn.Sequential(
        FirstConvolution(1, 32, 8, 4), nn.LeakyReLU(),
        nn.Conv2d(32, 64, 4, 2), nn.LeakyReLU(),
        nn.Conv2d(64, 64, 3, 1), nn.LeakyReLU(),
        nn.Flatten(),
    )  # fmt: skip
