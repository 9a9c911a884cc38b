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
@pytest.mark.parametrize("members", [1, 3])
@pytest.mark.parametrize("from_previous", [False, True])
def test_every_form_of_haptic_curiosity(haptics, members, from_previous):
    config = replace(CONFIG, haptics=haptics, members=members, from_previous=from_previous)
    curiosity, batch = make("hac", config), random_batch()
    curiosity.update(batch)
    assert torch.isfinite(curiosity.reward(batch)).all()
    unseen = replace(batch, image=255 - batch.image)
    same = torch.equal(curiosity.surprise(batch), curiosity.surprise(unseen))
    assert same != from_previous


def test_the_sign_of_a_force_does_not_change_its_magnitude():
    curiosity, batch = make("hac", replace(CONFIG, haptics="magnitude")), random_batch()
    flipped = replace(batch, next_touch=-batch.next_touch)
    assert torch.equal(curiosity.haptics(batch), curiosity.haptics(flipped))


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
