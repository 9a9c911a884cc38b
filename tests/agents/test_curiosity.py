from dataclasses import replace

import pytest
import torch

from minitouch_bench.agents.config import HAPTICS, CuriosityConfig
from minitouch_bench.agents.curiosity import METHODS, make_curiosity
from tests.agents.batches import random_batch

CONFIG = CuriosityConfig(width=0.25, bfloat16=False, learning_rate=1e-3)
CURIOUS = [method for method in METHODS if method != "sac"]


def make(method, config=CONFIG):
    torch.manual_seed(0)
    curiosity = make_curiosity(method, config, 4)
    curiosity.begin()
    return curiosity


def test_sac_has_none():
    assert make_curiosity("sac", CONFIG, 4) is None


@pytest.mark.parametrize("method", CURIOUS)
def test_what_is_learned_from_surprises_less(method):
    curiosity, batch = make(method), random_batch()
    before = curiosity.surprise(batch).detach()
    losses = [float(curiosity.update(batch)["curiosity_loss"]) for _ in range(15)]
    assert before.shape == (8,)
    assert (before >= 0).all()
    assert losses[-1] < losses[0]
    assert curiosity.surprise(batch).mean() < before.mean()


@pytest.mark.parametrize("method", ["hac", "icm-touch", "rnd-touch"])
def test_touch_counts_where_the_name_says_so(method):
    curiosity, batch = make(method), random_batch()
    other = replace(batch, next_touch=batch.next_touch + 1.0)
    assert not torch.equal(curiosity.surprise(batch), curiosity.surprise(other))


@pytest.mark.parametrize("method", ["icm", "disagreement", "rnd"])
def test_touch_does_not_count_elsewhere(method):
    curiosity, batch = make(method), random_batch()
    other = replace(batch, touch=batch.touch + 1.0, next_touch=batch.next_touch + 1.0)
    assert torch.equal(curiosity.surprise(batch), curiosity.surprise(other))


@pytest.mark.parametrize("haptics", HAPTICS)
@pytest.mark.parametrize("standardize", [False, True])
@pytest.mark.parametrize("from_previous", [False, True])
def test_every_form_of_haptic_curiosity(haptics, standardize, from_previous):
    config = replace(CONFIG, haptics=haptics, standardize=standardize, from_previous=from_previous)
    curiosity, batch = make("hac", config), random_batch()
    curiosity.update(batch)
    assert torch.isfinite(curiosity.reward(batch)).all()
    unseen = replace(batch, image=255 - batch.image)
    same = torch.equal(curiosity.surprise(batch), curiosity.surprise(unseen))
    assert same != from_previous


@pytest.mark.parametrize(("standardize", "rare_first"), [(False, False), (True, True)])
def test_a_rare_touch_outweighs_forces_that_are_always_random(standardize, rare_first):
    curiosity = make("hac", replace(CONFIG, standardize=standardize))
    pressed = torch.arange(8) < 4
    picture = (255 * pressed.byte())[:, None, None, None].expand(8, 1, 84, 84).contiguous()
    batch = replace(random_batch(), next_image=picture)

    def felt(seed):
        signs = torch.randn(8, 11, generator=torch.Generator().manual_seed(seed)).sign()
        return replace(batch, next_touch=torch.where(pressed[:, None], 5.0 * signs, 0.0))

    for seed in range(200):
        curiosity.update(felt(seed))
    random_forces = curiosity.surprise(felt(200))[:4].mean()
    light_touch = curiosity.surprise(replace(batch, next_touch=torch.full((8, 11), 0.5)))[4:]
    assert (light_touch.min() > random_forces) == rare_first


def test_rewards_are_divided_by_their_standard_deviation_so_far():
    curiosity = make("hac")
    batches = [random_batch(seed=seed) for seed in range(3)]
    surprises = [curiosity.surprise(batch).detach() for batch in batches]
    rewards = [curiosity.reward(batch) for batch in batches]
    deviation = torch.cat(surprises).double().std(correction=0).float()
    torch.testing.assert_close(rewards[-1], surprises[-1] / deviation)


def test_disagreement_of_copies_is_zero():
    curiosity, batch = make("disagreement"), random_batch()
    for member in curiosity.members:
        member.load_state_dict(curiosity.members[0].state_dict())
    assert curiosity.surprise(batch).max() < 1e-10
