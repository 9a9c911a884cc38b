import pytest
import torch

from minitouch_bench.policies.networks import VisualEncoder


def test_encoder_has_the_feature_maps_of_table_3():
    encoder = VisualEncoder()
    image = torch.zeros(2, 1, 84, 84, dtype=torch.uint8)
    sizes, maps = [], image.float()
    for layer in encoder.convolutions:
        maps = layer(maps)
        if isinstance(layer, torch.nn.Conv2d):
            sizes.append(tuple(maps.shape[1:]))
    assert sizes == [(32, 20, 20), (64, 9, 9), (124, 4, 4), (256, 2, 2)]
    assert encoder(image).shape == (2, 256)


@pytest.mark.parametrize("width", [1.0, 0.25])
def test_arranged_convolutions_round_no_worse_than_plain_ones(width):
    torch.manual_seed(0)
    arranged = VisualEncoder(width).convolutions
    plain = torch.nn.Sequential(*map(as_plain, arranged))
    images = torch.randint(0, 256, (32, 1, 84, 84), dtype=torch.uint8)
    exact = maps_and_gradients(plain, images / 255, half=False)
    ours = maps_and_gradients(arranged, images, half=True)
    theirs = maps_and_gradients(plain, images / 255, half=True)
    for mine, other, right in zip(ours, theirs, exact, strict=True):
        assert (mine - right).norm() < 1.2 * (other - right).norm()
        assert (mine - right).norm() < 0.2 * right.norm()


def maps_and_gradients(convolutions, image, *, half):
    """Return the maps, and the gradient of their weighted sum for each parameter, float32."""
    with torch.autocast("cpu", torch.bfloat16, enabled=half):
        maps = convolutions(image).float()
    weights = torch.randn(maps.shape, generator=torch.Generator().manual_seed(1))
    return maps, *torch.autograd.grad((maps * weights).sum(), [*convolutions.parameters()])


def as_plain(layer):
    """Return a convolution with the same weights that PyTorch computes."""
    if not isinstance(layer, torch.nn.Conv2d):
        return layer
    sizes = (layer.in_channels, layer.out_channels, layer.kernel_size, layer.stride)
    plain = torch.nn.Conv2d(*sizes)
    plain.load_state_dict(layer.state_dict())
    return plain
