"""Learning to find keypoints: an image is drawn again from where they are.

No reward and no state of the simulator is used. What moves in front of a fixed background can only
be drawn by a keypoint that follows it (Finn et al. 2016, Jakab et al. 2018). One of the keypoints
follows the hand, whose position is in the touch vector. So it is known where in the image the hand
is, and policies see all keypoints relative to it.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn

from minitouch_bench.policies.networks import (
    KEYPOINT_FEATURES,
    KEYPOINT_SCALE,
    KEYPOINT_STRIDE,
    KEYPOINTS,
    KeypointEncoder,
    TouchActor,
    coordinates_along,
    gray_tiles,
)
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.simulation.observation import POSITION

LEARNING_RATE = 6e-3
"""Of Adam, for half of the gradient steps; then it falls linearly to 0."""

BATCH = 64
"""Images of one gradient step."""

SAMPLE = 2048
"""Observations from which each pixel's deviation is computed, and where the hand is seen."""

DRAWN = PROTOCOL.observation.image_size // KEYPOINT_STRIDE
"""Height and width of a drawing, in pixels."""

FIRST_BLOB = 0.12 * KEYPOINT_SCALE
"""Standard deviation of a new blob, as coordinates: 1.2 pixels of the drawing."""

DARKEST_BLOB = -0.2
"""Gray levels of new blobs lie between this and 0, relative to the background."""

LEAST_DEVIATION = 0.02
"""Gray levels, of 0 to 1, added to a pixel's standard deviation before it divides errors."""

LEAST_SPREAD = 1e-6
"""Variance of a keypoint's place, as coordinates, below which it does not move and is no hand."""

Draw = Callable[[int], tuple[Tensor, Tensor]]
"""Draws N observations: images uint8 (N, 1, H, W), touch as networks see it, float32 (N, 11)."""


class Keypoints(nn.Module):
    """An encoder of keypoints, and where in the image the hand is at each of its positions."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = KeypointEncoder()
        self.drawing = Drawing()
        self.hand: Tensor = nn.Buffer(torch.zeros(4, 2))

    def learn(self, draw: Draw, updates: int) -> None:
        """Learn keypoints in ``updates`` gradient steps, then which of them is the hand."""
        images, touch = draw(SAMPLE)
        small = gray_tiles(images).mean(dim=3)
        deviation = small.std(dim=0) + LEAST_DEVIATION
        self.drawing.background.data.copy_(small.mean(dim=0))
        optimizer = torch.optim.Adam(self.parameters(), LEARNING_RATE, fused=True)
        for update in range(updates):
            for group in optimizer.param_groups:
                group["lr"] = LEARNING_RATE * min(1.0, 2.0 * (1.0 - update / updates))
            batch, _ = draw(BATCH)
            wanted = gray_tiles(batch).mean(dim=3)
            error = (self.drawing(self.encoder(batch)) - wanted) / deviation
            optimizer.zero_grad()
            error.square().mean().backward()
            optimizer.step()
        self.find_hand(self._places(images), touch)

    def find_hand(self, places: Tensor, touch: Tensor) -> None:
        """Fit an affine map from the hand's position to the keypoint that it explains best.

        ``places`` float32 (N, 2 * KEYPOINTS), in images at whose time ``touch`` (N, 11) was felt.
        """
        given = _with_one(touch).double().cpu()
        wanted = places.double().cpu()
        # What the usual driver returns depends on freed memory: PyTorch's issue 187411.
        maps = torch.linalg.lstsq(given, wanted, driver="gelsd").solution
        left = (given @ maps - wanted).square().mean(dim=0).view(2, KEYPOINTS).sum(dim=0)
        spread = wanted.var(dim=0).view(2, KEYPOINTS).sum(dim=0)
        best = int((left / spread).masked_fill(spread < LEAST_SPREAD, math.inf).argmin())
        self.hand.copy_(maps[:, [best, KEYPOINTS + best]])

    def encode(self, image: Tensor, touch: Tensor) -> Tensor:
        """Return all keypoints relative to the hand, float32 (N, 2 * KEYPOINTS).

        ``image`` uint8 (N, 1, H, W); ``touch`` float32 (N, 11) as networks see it.
        """
        hand = _with_one(touch) @ self.hand
        return self._places(image) - hand.repeat_interleave(KEYPOINTS, dim=1)

    @torch.no_grad()
    def fold_into(self, actor: TouchActor) -> None:
        """Change an actor on what ``encode`` returns into one on what the encoder returns."""
        weight, bias = actor.first_layer.weight, actor.first_layer.bias
        seen, felt = weight[:, :KEYPOINT_FEATURES], weight[:, KEYPOINT_FEATURES:]
        moved = seen.view(-1, 2, KEYPOINTS).sum(dim=2) @ self.hand.T.to(weight.device)
        felt[:, POSITION].sub_(moved[:, :3])
        bias.sub_(moved[:, 3])

    @torch.no_grad()
    def _places(self, image: Tensor) -> Tensor:
        count = math.ceil(len(image) / BATCH)
        return torch.cat([self.encoder(some) for some in image.chunk(count)])


def _with_one(touch: Tensor) -> Tensor:
    """Return the hand's positions and a 1, float32 (N, 4)."""
    return nn.functional.pad(touch[:, POSITION], (0, 1), value=1.0)


class Drawing(nn.Module):
    """What draws images from keypoints, at a quarter of their size.

    A drawing is a learned background and, for each keypoint, a round blob of a learned gray level
    and size. The loss is the squared error, divided by the variance of each pixel over the images
    of the memory: otherwise the arm, which fills most of what changes, would take every keypoint.
    """

    def __init__(self) -> None:
        super().__init__()
        self.background = nn.Parameter(torch.zeros(DRAWN, DRAWN))
        self.gray = nn.Parameter(DARKEST_BLOB * torch.rand(KEYPOINTS))
        self.log_size = nn.Parameter(torch.full((KEYPOINTS,), math.log(FIRST_BLOB)))

    def forward(self, features: Tensor) -> Tensor:
        """Return drawings float32 (N, 21, 21) of features float32 (N, 2 * KEYPOINTS)."""
        places = coordinates_along(DRAWN, features.device)
        scale = (-self.log_size).exp()[:, None]
        down, right = (
            (-0.5 * ((places - one[..., None]) * scale).square()).exp()
            for one in features.chunk(2, dim=1)
        )
        blobs = (down * self.gray[:, None]).transpose(1, 2) @ right
        return self.background + blobs
