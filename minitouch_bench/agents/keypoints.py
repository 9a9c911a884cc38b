"""Learning to find keypoints: an image is drawn again from where they are.

No reward and no state of the simulator is used. What moves in front of a fixed background can only
be drawn by a keypoint that follows it (Finn et al. 2016, Jakab et al. 2018).
"""

import math
from typing import Any

import torch
from torch import Tensor, nn

from minitouch_bench.agents.curiosity import PixelStatistics
from minitouch_bench.policies.networks import (
    KEYPOINT_SCALE,
    KEYPOINT_STRIDE,
    KEYPOINTS,
    KeypointEncoder,
    coordinates_along,
    gray_tiles,
)
from minitouch_bench.protocol.minitouch import PROTOCOL

LEARNING_RATE = 2e-3

DRAWN = PROTOCOL.observation.image_size // KEYPOINT_STRIDE
"""Height and width of a drawing, in pixels."""

FIRST_BLOB = 0.12 * KEYPOINT_SCALE
"""Standard deviation of a new blob, as coordinates: 1.2 pixels of the drawing."""

DARKEST_BLOB = -0.2
"""Gray levels of new blobs lie between this and 0, relative to the background."""

LEAST_DEVIATION = 0.02
"""Gray levels, of 0 to 1, added to a pixel's standard deviation before it divides errors."""


class KeypointModel(nn.Module):
    """An encoder, and what draws images from its keypoints at a quarter of their size.

    A drawing is a learned background and, for each keypoint, a round blob of a learned gray level
    and size. The loss is the squared error, divided by the variance of each pixel over all images
    seen: otherwise the arm, which fills most of what changes, would take every keypoint.
    """

    def __init__(self) -> None:
        super().__init__()
        self.encoder = KeypointEncoder()
        self.background = nn.Parameter(torch.zeros(DRAWN, DRAWN))
        self.gray = nn.Parameter(DARKEST_BLOB * torch.rand(KEYPOINTS))
        self.log_size = nn.Parameter(torch.full((KEYPOINTS,), math.log(FIRST_BLOB)))
        self.statistics = PixelStatistics((DRAWN, DRAWN))

    def begin(self) -> None:
        """Make the optimizer, once everything is in place on its device."""
        self.optimizer = torch.optim.Adam(self.parameters(), LEARNING_RATE, fused=True)

    def update(self, image: Tensor) -> Tensor:
        """Do one gradient step on images uint8 (N, 1, H, W); return the loss before it."""
        small = gray_tiles(image).mean(dim=3)
        self.statistics.watch(small)
        deviation = self.statistics.variance(0.0).sqrt() + LEAST_DEVIATION
        error = (self.draw(self.encoder(image)) - small) / deviation
        loss = error.square().mean()
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()
        return loss.detach()

    def draw(self, features: Tensor) -> Tensor:
        """Return drawings float32 (N, 21, 21) of features float32 (N, 2 * KEYPOINTS)."""
        places = coordinates_along(DRAWN, features.device)
        scale = (-self.log_size).exp()[:, None]
        down, right = (
            (-0.5 * ((places - one[..., None]) * scale).square()).exp()
            for one in features.chunk(2, dim=1)
        )
        blobs = (down * self.gray[:, None]).transpose(1, 2) @ right
        return self.background + blobs

    @torch.no_grad()
    def encode(self, image: Tensor) -> Tensor:
        """Return features float32 (N, 2 * KEYPOINTS) of images uint8 (N, 1, H, W)."""
        features: Tensor = self.encoder(image)
        return features

    def state(self) -> dict[str, Any]:
        """Return everything that later steps depend on."""
        return {"keypoints": self.state_dict(), "keypoint_optimizer": self.optimizer.state_dict()}

    def load_state(self, state: dict[str, Any]) -> None:
        """Go on from what ``state`` returned; other keys are left alone."""
        self.load_state_dict(state["keypoints"])
        self.optimizer.load_state_dict(state["keypoint_optimizer"])
