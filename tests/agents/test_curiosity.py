from dataclasses import replace

import numpy as np
import pytest
import torch

from minitouch_bench.agents import METHODS
from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.curiosity import CURIOSITIES, Whitening
from minitouch_bench.tasks.environment import MiniTouchEnv
from tests.agents.batches import random_batch

CONFIG = CuriosityConfig(width=0.25, bfloat16=False, learning_rate=1e-3)
CURIOUS = [method for method in METHODS if method != "sac"]


def make(method, config=CONFIG):
    torch.manual_seed(0)
    curiosity = CURIOSITIES[method](config, 4)
    curiosity.begin()
    return curiosity


def surprise(curiosity, batch):
    return curiosity.errors(batch).surprise.detach()


@pytest.mark.parametrize("method", CURIOUS)
def test_what_is_learned_from_surprises_less_than_the_weights_before_it(method):
    curiosity, same, batch = make(method), make(method), random_batch()
    before, first = same.errors(batch), curiosity.update(batch)
    assert torch.equal(first.surprise, before.surprise.detach())
    assert torch.equal(first.loss, before.loss.detach())
    assert first.surprise.shape == (8,)
    assert (first.surprise >= 0).all()
    losses = [float(curiosity.update(batch).loss) for _ in range(59)]
    assert losses[-1] < float(first.loss)
    assert surprise(curiosity, batch).mean() < first.surprise.mean()


@pytest.mark.parametrize("method", CURIOUS)
def test_touch_counts_where_the_name_says_so_and_nowhere_else(method):
    curiosity, batch = make(method), random_batch()
    other = replace(batch, next_touch=batch.next_touch + 1.0)
    if method in ("icm", "disagreement", "rnd"):
        other = replace(other, touch=batch.touch + 1.0)
        assert torch.equal(surprise(curiosity, batch), surprise(curiosity, other))
    else:
        assert not torch.equal(surprise(curiosity, batch), surprise(curiosity, other))
    if method == "hac":  # which sees the reached state alone
        unseen = replace(batch, image=255 - batch.image)
        assert torch.equal(surprise(curiosity, batch), surprise(curiosity, unseen))


def test_touch_and_image_change_the_random_target_alike():
    seen = transitions(play("opening", 4, 25))
    images, touch = seen.next_image, seen.next_touch
    touch = (touch - touch.mean(dim=0)) / (touch.std(dim=0) + 1e-6)
    for seed in range(3):
        torch.manual_seed(seed)
        curiosity = CURIOSITIES["rnd-touch"](CONFIG, 5)
        curiosity.whitening.watch(images)
        whitened = curiosity.whitening(images)
        order = torch.randperm(len(images))

        def target(image, felt, of=curiosity):
            return of.target_head(of._seen(of.target_maps, image, felt))

        with torch.no_grad():
            true = target(whitened, touch)
            by_touch = (target(whitened, touch[order]) - true).square().mean()
            by_image = (target(whitened[order], touch) - true).square().mean()
        assert 0.3 < by_touch / (by_touch + by_image) < 0.7


def play(task, episodes, steps):
    """Return each (observation, random action, next observation)."""
    environment, seen = MiniTouchEnv(task), []
    environment.action_space.seed(0)
    for seed in range(episodes):
        now, _ = environment.reset(seed=seed)
        for _ in range(steps):
            action = environment.action_space.sample()
            then = environment.step(action)[0]
            seen.append((now, action, then))
            now = then
    environment.close()
    return seen


def transitions(seen):
    """Return what ``play`` gave as a batch."""
    now, actions, then = zip(*seen, strict=True)
    images, touch, next_images, next_touch = (
        torch.as_tensor(np.stack([one[key] for one in observed]))
        for observed in (now, then)
        for key in ("image", "touch")
    )
    return replace(
        random_batch(len(seen)),
        image=images, touch=touch, next_image=next_images, next_touch=next_touch,
        action=torch.as_tensor(np.stack(actions)),
    )  # fmt: skip


def test_rewards_are_divided_by_their_standard_deviation_so_far():
    curiosity = make("hac")
    batches = [random_batch(seed=seed) for seed in range(3)]
    surprises = [surprise(curiosity, batch) for batch in batches]
    rewards = [curiosity.reward(one) for one in surprises]
    deviation = torch.cat(surprises).double().std(correction=0).float()
    torch.testing.assert_close(rewards[-1], surprises[-1] / deviation)


@pytest.mark.parametrize("method", CURIOUS)
def test_large_first_surprises_are_forgotten_but_by_haptic_curiosity(method):
    curiosity = make(method)
    values = torch.linspace(0.5, 1.5, 128)
    for _ in range(10):
        curiosity.reward(1000 * values)
    for _ in range(2000):
        reward = curiosity.reward(values)
    deviation = float(values.std(correction=0) / reward.std(correction=0))
    if method == "hac":
        assert deviation > 50
    else:
        assert deviation == pytest.approx(float(values.std(correction=0)), rel=0.01)


def test_whitened_pixels_have_unit_variance_and_a_limit():
    whitening = Whitening((1, 84, 84), least_deviation=1.0)
    images = torch.randint(0, 100, (512, 1, 84, 84), dtype=torch.uint8)
    for half in images.split(256):
        whitening.watch(half)
    whitened = whitening(images)
    torch.testing.assert_close(whitened.mean(dim=0), torch.zeros(1, 84, 84), atol=1e-3, rtol=0)
    torch.testing.assert_close(whitened.std(dim=0), torch.ones(1, 84, 84), atol=0.01, rtol=0)
    assert whitening(torch.full((1, 1, 84, 84), 255, dtype=torch.uint8)).max() == 5.0


@pytest.mark.slow
@pytest.mark.parametrize("method", ["disagreement", "rnd"])
def test_what_was_never_seen_surprises_more_than_the_nearest_to_the_camera(method):
    """There the arm fills most of the image, and a model that fits little is always wrong."""
    seen = sorted(play("playing", 12, 50), key=lambda one: one[0]["touch"][0])
    far, near = seen[:300], seen[300:]
    curiosity, rng = make(method, CuriosityConfig()), np.random.default_rng(0)
    for _ in range(300):
        curiosity.update(transitions([near[row] for row in rng.choice(300, 128)]))
    never, often = (surprise(curiosity, transitions(part[::3])).mean() for part in (far, near))
    assert never > 1.5 * often


def test_disagreement_of_copies_is_zero():
    curiosity, batch = make("disagreement"), random_batch()
    for member in curiosity.members:
        member.load_state_dict(curiosity.members[0].state_dict())
    assert surprise(curiosity, batch).max() < 1e-10
