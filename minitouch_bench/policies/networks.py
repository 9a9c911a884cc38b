"""The actor on image and touch, and its two encoders: the paper's, and one that finds keypoints."""

import math
from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from minitouch_bench.protocol.minitouch import PROTOCOL

ENCODER_CHANNELS = (32, 64, 124, 256)
"""Outputs of the four convolutions (supplement, Table 3)."""

ENCODER_KERNELS = (8, 4, 3, 2)
"""Kernel sizes of the four convolutions, in pixels (supplement, Table 3)."""

ENCODER_STRIDES = (4, 2, 2, 2)
"""Strides. Table 3 prints 4, 2, 1, 1, with which its sizes 20, 8, 4, 2 do not come out; with these
strides all but one do (9 in place of 8)."""

ENCODER_GRID = 2
"""Height and width of the last feature map, as Table 3 of the supplement prints."""

FEATURES = 256
"""Outputs of the encoder's fully-connected layer (supplement, Table 3)."""

HIDDEN_UNITS = 128
"""Units in each of the actor's two hidden layers (supplement, Table 2)."""

KEYPOINTS = 16
"""Keypoints that the keypoint encoder finds in an image."""

KEYPOINT_FEATURES = 2 * KEYPOINTS
"""Coordinates of all keypoints."""

KEYPOINT_STRIDE = 4
"""Pixels between two places of a keypoint's map, as the first stride of Table 3."""

KEYPOINT_CHANNELS = 16

SOFTMAX_GAIN = 5.0
"""Factor on a keypoint's map before its softmax, so that a new encoder's maps have peaks."""

KEYPOINT_SCALE = 4.0
"""What the border of the image counts as a coordinate; its middle is 0."""

TOUCH_SIZE = PROTOCOL.observation.touch_size
"""Length of the touch vector (supplement, 7.3)."""

BRIGHTEST = 255.0
"""The gray level that networks see as 1."""

LOG_STD_BOUNDS = (-20.0, 2.0)
"""Clamp on the log standard deviation; the paper names none, these are SAC's own."""


class ImageConvolutions(nn.Sequential):
    """Convolutions of an image, the second with stride 2; half precision rearranges them.

    The second one then sees 2 x 2 maps as channels of one, and the first one makes them at once:
    four times its kernel, each moved by its stride, in a kernel of 12 x 12 pixels with stride 8,
    on 4 x 4 pixels as channels. The same sums, and their gradients take oneDNN half the time.
    """

    def forward(self, image: Tensor) -> Tensor:
        """Return maps of images (N, 1, H, W), float32, or uint8 for gray levels seen as 0 to 1.

        Images get no gradient in half precision.
        """
        brightest = BRIGHTEST if image.dtype == torch.uint8 else 1.0
        if not torch.is_autocast_enabled(image.device.type):
            return super().forward(image.float() / brightest)  # type: ignore[no-untyped-call]
        first, activation, second, *others = self
        assert isinstance(first, nn.Conv2d)
        assert isinstance(second, nn.Conv2d)
        assert first.bias is not None
        size = first.stride[0]
        kernels = [
            functional.pad(first.weight, (x, size - x, y, size - y))
            for y in (0, size)
            for x in (0, size)
        ]
        weight = _blocks(torch.cat(kernels) / brightest, size).permute(0, 3, 1, 2)
        if image.dtype != torch.uint8:
            image = image.bfloat16()
        tiles = pixel_tiles(image).bfloat16().permute(0, 3, 1, 2)
        maps = functional.conv2d(tiles, weight, first.bias.repeat(4), stride=2)
        weight = _blocks(second.weight, 2).permute(0, 3, 1, 2)
        maps = functional.conv2d(activation(maps), weight, second.bias)
        for layer in others:
            maps = layer(maps)
        return maps


def pixel_tiles(image: Tensor) -> Tensor:
    """Return images (N, 1, H, W), uint8 or of two bytes a pixel, as (N, H / 4, W / 4, 16)."""
    fours = image.view(torch.int32 if image.dtype == torch.uint8 else torch.int64)
    count, _, height, width = fours.shape
    moved = fours.reshape(count, height // 4, 4, width).transpose(2, 3).contiguous()
    return moved.view(image.dtype)


class TileConvolution(nn.Conv2d):
    """A convolution with its kernel's size as stride; in half precision one matrix product."""

    def forward(self, maps: Tensor) -> Tensor:
        """Return maps (N, C', H / stride, W / stride) of maps (N, C, H, W)."""
        if not torch.is_autocast_enabled(maps.device.type):
            return super().forward(maps)
        weight = _blocks(self.weight, self.stride[0]).flatten(1)
        tiles = _blocks(maps, self.stride[0])
        return functional.linear(tiles, weight, self.bias).permute(0, 3, 1, 2)


def _blocks(maps: Tensor, size: int) -> Tensor:
    """Return maps (N, C, H, W) as (N, H / size, W / size, size * size * C)."""
    count, channels, height, width = maps.shape
    split = maps.reshape(count, channels, height // size, size, width // size, size)
    return split.permute(0, 2, 4, 3, 5, 1).flatten(3)


class VisualEncoder(nn.Module):
    """Map a gray image to 256 features (supplement, Table 3).

    The paper's feature maps: 84 -> 20 -> 9 (printed as 8) -> 4 -> 2 pixels. LeakyReLU after
    each layer.
    ``width`` scales the numbers of channels, up to a multiple of 8; 1 is the table's.
    """

    def __init__(self, width: float = 1.0) -> None:
        super().__init__()
        self.width = width
        layers: list[nn.Module] = []
        channels = PROTOCOL.observation.image_shape[0]
        for outputs, kernel, stride in zip(
            ENCODER_CHANNELS, ENCODER_KERNELS, ENCODER_STRIDES, strict=True
        ):
            wide = min(outputs, 8 * math.ceil(width * outputs / 8))
            convolution = TileConvolution if kernel == stride else nn.Conv2d
            layers += [convolution(channels, wide, kernel, stride), nn.LeakyReLU()]
            channels = wide
        self.convolutions = ImageConvolutions(*layers)
        self.projection = nn.Sequential(
            nn.Linear(channels * ENCODER_GRID**2, FEATURES), nn.LeakyReLU()
        )

    def forward(self, image: Tensor) -> Tensor:
        """Return features float32 (N, 256) of images (N, C, H, W): see ``ImageConvolutions``."""
        maps = self.convolutions(image)
        return self.projection(maps.flatten(1))


class KeypointEncoder(nn.Module):
    """Map a gray image to the coordinates of keypoints (Finn et al. 2016).

    Convolutions see windows of 16 x 16 pixels and give a map of 20 x 20 places per keypoint. The
    softmax of this map says where the keypoint is; its mean place is the keypoint's coordinates.
    Coordinates mean the same everywhere in the image, so a policy needs few scenes to learn from
    them.
    """

    width = 1.0
    """There is one width of this encoder."""

    def __init__(self) -> None:
        super().__init__()
        self.windows = nn.Conv2d(KEYPOINT_STRIDE**2, KEYPOINT_CHANNELS, 2)
        self.neighbors = nn.Conv2d(KEYPOINT_CHANNELS, KEYPOINT_CHANNELS, 3, padding=1)
        self.maps = nn.Linear(KEYPOINT_CHANNELS, KEYPOINTS)

    def forward(self, image: Tensor) -> Tensor:
        """Return features float32 (N, 2 * KEYPOINTS) of images uint8 (N, 1, H, W)."""
        tiles = gray_tiles(image).permute(0, 3, 1, 2)
        hidden = functional.leaky_relu(self.windows(tiles))
        hidden = functional.leaky_relu(self.neighbors(hidden)).permute(0, 2, 3, 1)
        count, height, width, _ = hidden.shape
        maps = SOFTMAX_GAIN * self.maps(hidden).flatten(1, 2).transpose(1, 2)
        share = maps.softmax(dim=2).view(count, KEYPOINTS, height, width)
        down = share.sum(dim=3) @ coordinates_along(height, image.device)
        right = share.sum(dim=2) @ coordinates_along(width, image.device)
        return torch.cat((down, right), dim=1)


def gray_tiles(image: Tensor) -> Tensor:
    """Return the gray levels, -0.5 to 0.5, of tiles of 4 x 4 pixels, float32 (N, H / 4, W / 4, 16).

    Images are uint8 (N, 1, H, W).
    """
    return pixel_tiles(image).float() / BRIGHTEST - 0.5


def coordinates_along(size: int, device: torch.device) -> Tensor:
    """Return the coordinates of ``size`` places from one border of the image to the other."""
    return torch.linspace(-KEYPOINT_SCALE, KEYPOINT_SCALE, size, device=device)


class TouchActor(nn.Module):
    """Squashed Gaussian policy of SAC on image and touch (supplement, Table 2 and 3).

    The image's 256 features and the 11 touch numbers pass through two hidden layers of 128
    LeakyReLU units, which end in the mean and the log standard deviation of each action.
    """

    architecture = "hac-actor-v1"

    def __init__(
        self,
        action_size: int,
        *,
        encoder: nn.Module | None = None,
        features: int = FEATURES,
        touch_size: int = TOUCH_SIZE,
    ) -> None:
        super().__init__()
        self.action_size = action_size
        self.encoder = encoder or VisualEncoder()
        self.trunk = nn.Sequential(
            nn.Linear(features + touch_size, HIDDEN_UNITS),
            nn.LeakyReLU(),
            nn.Linear(HIDDEN_UNITS, HIDDEN_UNITS),
            nn.LeakyReLU(),
        )
        self.mean = nn.Linear(HIDDEN_UNITS, action_size)
        self.log_std = nn.Linear(HIDDEN_UNITS, action_size)

    @property
    def first_layer(self) -> nn.Linear:
        """The layer that takes the encoder's features and touch."""
        layer = self.trunk[0]
        assert isinstance(layer, nn.Linear)
        return layer

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        """Return tanh(mean), float32 (N, A); image uint8 (N, 1, H, W), touch float32 (N, 11)."""
        mean, _ = self.gaussian(image, touch)
        return torch.tanh(mean)

    def gaussian(self, image: Tensor, touch: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and log standard deviation before squashing, each float32 (N, A)."""
        return self.gaussian_of(self.encoder(image), touch)

    def gaussian_of(self, features: Tensor, touch: Tensor) -> tuple[Tensor, Tensor]:
        """Return what ``gaussian`` does, from the encoder's features (N, 256)."""
        hidden = self.trunk(torch.cat((features, touch), dim=1))
        return self.mean(hidden), self.log_std(hidden).clamp(*LOG_STD_BOUNDS)

    def sample(self, image: Tensor, touch: Tensor, generator: torch.Generator) -> Tensor:
        """Return a stochastic action tanh(mean + std * noise), float32 (N, A)."""
        mean, log_std = self.gaussian(image, touch)
        noise = torch.randn(mean.shape, generator=generator, device=mean.device)
        return torch.tanh(mean + log_std.exp() * noise)


class KeypointActor(TouchActor):
    """The same on the coordinates of keypoints and touch."""

    architecture = "keypoint-actor-v1"


ARCHITECTURES: Mapping[str, Callable[[int, float], TouchActor]] = {
    TouchActor.architecture: lambda size, width: TouchActor(size, encoder=VisualEncoder(width)),
    KeypointActor.architecture: lambda size, _: KeypointActor(
        size, encoder=KeypointEncoder(), features=KEYPOINT_FEATURES
    ),
}
"""Makers of actors by architecture id, from the action's size and the encoder's width."""
