"""Keypoints follow what moves, without being told where it is."""

import copy

import numpy as np
import torch

from minitouch_bench.agents.keypoints import KeypointModel
from minitouch_bench.agents.replay import Replay
from minitouch_bench.policies.networks import KEYPOINT_FEATURES


def scenes(count, seed):
    """Return images of a dark and a gray square on a lighter ground, and their places in pixels."""
    rng = np.random.default_rng(seed)
    places = rng.integers(8, 68, (count, 2, 2))
    images = np.full((count, 1, 84, 84), 180, np.uint8)
    for image, two in zip(images, places, strict=True):
        for (row, column), gray in zip(two, (30, 100), strict=True):
            image[0, row : row + 8, column : column + 8] = gray
    return torch.from_numpy(images), torch.from_numpy(places).flatten(1).float()


def make(seed=0):
    torch.manual_seed(seed)
    model = KeypointModel().to(memory_format=torch.channels_last)
    model.begin()
    return model


def error_of(model):
    """Return the error (pixels) of places read linearly from keypoints, on other scenes."""
    (images, places), (others, there) = scenes(500, 1), scenes(300, 2)
    one, other = (
        torch.cat((model.encode(seen), torch.ones(len(seen), 1)), dim=1)
        for seen in (images, others)
    )
    solution = torch.linalg.lstsq(one, places).solution
    return float((other @ solution - there).square().mean().sqrt())


def test_places_of_objects_can_be_read_from_keypoints_that_never_saw_them():
    model = make()
    before = error_of(model)
    images, _ = scenes(2000, 0)
    rng = np.random.default_rng(0)
    for _ in range(150):
        model.update(images[rng.integers(len(images), size=64)])
    after = error_of(model)
    assert after < 2.5
    assert after < 0.75 * before  # random convolutions tell places apart, too


def test_a_model_goes_on_from_its_state():
    images, _ = scenes(8, 0)
    one, other = make(), make(seed=1)
    one.update(images)
    other.load_state(copy.deepcopy(one.state()))
    assert one.update(images) == other.update(images)
    assert torch.equal(one.encode(images), other.encode(images))


def test_a_memory_that_is_encoded_gives_the_features_of_its_images():
    images, _ = scenes(6, 0)
    replay, model, rng = Replay(4, 11, 4, KEYPOINT_FEATURES), make(), np.random.default_rng(0)
    touch = np.zeros(11, np.float32)
    replay.begin_episode(images[0].numpy(), touch)
    for image in images[1:]:
        action = np.zeros(4, np.float32)
        replay.add(action, 0.0, image.numpy(), touch, success=False, ended=False)
    replay.encode(model.encode)
    known = model.encode(images)
    chances = {"n_step": 1, "discount": 1.0, "success_share": 0.0, "device": torch.device("cpu")}
    batch = replay.sample(rng, 32, **chances)
    for now, then in zip(batch.features, batch.next_features, strict=True):
        row = int((known - now).square().sum(dim=1).argmin())
        torch.testing.assert_close(now, known[row])
        torch.testing.assert_close(then, known[row + 1])
