"""Keypoints follow what moves, without being told where it is."""

import numpy as np
import torch
from torch import nn

from minitouch_bench.agents.keypoints import Keypoints
from minitouch_bench.agents.memory import ReplayMemory
from minitouch_bench.policies.networks import KEYPOINT_FEATURES, KEYPOINTS


def scenes(count, seed):
    """Return images, touch and places in pixels of a dark and a gray square on a lighter ground.

    The hand is where the dark square is.
    """
    rng = np.random.default_rng(seed)
    places = rng.integers(8, 68, (count, 2, 2))
    images = np.full((count, 1, 84, 84), 180, np.uint8)
    for image, two in zip(images, places, strict=True):
        for (row, column), gray in zip(two, (30, 100), strict=True):
            image[0, row : row + 8, column : column + 8] = gray
    touch = torch.zeros(count, 11)
    touch[:, :2] = torch.from_numpy(places[:, 0]) / 30.0 - 1.2
    return torch.from_numpy(images), touch, torch.from_numpy(places).flatten(1).float()


def make(updates=0):
    torch.manual_seed(0)
    model = Keypoints().to(memory_format=torch.channels_last)
    images, touch, _ = scenes(2000, 0)
    rng = np.random.default_rng(0)

    def draw(size):
        rows = rng.integers(len(images), size=size)
        return images[rows], touch[rows]

    model.learn(draw, updates)
    return model


def read(seen, wanted, others, there):
    """Return the error (pixels) of places read linearly, on other scenes."""
    one, other = (nn.functional.pad(some, (0, 1), value=1.0) for some in (seen, others))
    solution = torch.linalg.lstsq(one, wanted, driver="gelsd").solution
    return float((other @ solution - there).square().mean().sqrt())


def test_places_relative_to_the_hand_can_be_read_from_keypoints_that_never_saw_them():
    (images, touch, places), (others, felt, there) = scenes(500, 1), scenes(300, 2)
    relative, wanted = (two[:, 2:] - two[:, :2] for two in (places, there))
    model, before = make(150), make()
    errors = [
        read(one.encode(images, touch), relative, one.encode(others, felt), wanted)
        for one in (before, model)
    ]
    assert errors[1] < 3.0
    assert errors[1] < 0.75 * errors[0]  # random convolutions tell places apart, too


def test_the_keypoint_that_follows_the_hand_is_found():
    images, touch, _ = scenes(300, 2)
    relative = make(150).encode(images, touch).view(-1, 2, KEYPOINTS).square().sum(dim=1)
    # The hand itself is near 0 wherever it is; one coordinate is a tenth of the image.
    near, *others = relative.mean(dim=0).sqrt().sort().values
    assert near < 1.0
    assert others[0] > 1.5


def test_a_keypoint_that_does_not_move_is_not_the_hand():
    _, touch, _ = scenes(300, 2)
    places = torch.randn(300, KEYPOINT_FEATURES, generator=torch.Generator().manual_seed(0))
    places[:, [0, KEYPOINTS]] = 1.0
    places[:, [1, KEYPOINTS + 1]] = touch[:, :2] + 0.3 * places[:, [1, KEYPOINTS + 1]]
    model = Keypoints()
    for used in range(-20, 20):  # memory that is freed again
        _ = [torch.full((size,), used, dtype=torch.int32) for size in (2, 4, 4, 8)]
        model.find_hand(places, touch)
        torch.testing.assert_close(model.hand[:2], torch.eye(2), atol=0.1, rtol=0)


def test_a_memory_that_is_encoded_gives_the_features_of_its_images():
    images, touch, _ = scenes(6, 0)
    memory, model, rng = ReplayMemory(4, 11, 4, KEYPOINT_FEATURES), make(), np.random.default_rng(0)
    memory.begin_episode(images[0].numpy(), touch[0].numpy())
    for image, felt in zip(images[1:], touch[1:], strict=True):
        action = np.zeros(4, np.float32)
        memory.add(action, 0.0, image.numpy(), felt.numpy(), success=False, ended=False)
    memory.encode(model.encode)
    known = model.encode(images, touch)
    chances = {"n_step": 1, "discount": 1.0, "success_share": 0.0, "device": torch.device("cpu")}
    batch = memory.sample(rng, 32, **chances, encoded=True)
    for now, then in zip(batch.image, batch.next_image, strict=True):
        row = int((known - now).square().sum(dim=1).argmin())
        torch.testing.assert_close(now, known[row])
        torch.testing.assert_close(then, known[row + 1])
