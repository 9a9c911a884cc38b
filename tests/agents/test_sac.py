from dataclasses import replace

import torch

from minitouch_bench.agents.config import PhaseConfig, SacConfig
from minitouch_bench.agents.sac import Sac, shift_at_random
from tests.agents.batches import random_batch


def make(**phase):
    torch.manual_seed(0)
    sac = Sac(SacConfig(bfloat16=False), action_size=4, touch_size=11)
    sac.begin_phase(PhaseConfig(10, **phase))
    return sac


def generator():
    return torch.Generator().manual_seed(1)


def weights(module):
    return torch.cat([value.flatten() for value in module.state_dict().values()])


def test_critics_learn_the_reward_where_nothing_follows():
    sac, noise = make(learning_rate=1e-3), generator()
    final = replace(random_batch(), discount=torch.zeros(8))
    losses = [
        float(sac.update(final, final.task_reward, noise, 0)["critic_loss"]) for _ in range(25)
    ]
    assert losses[-1] < 0.5 * losses[0]


def test_the_actors_loss_leaves_encoder_and_critics_alone():
    sac = make(learning_rate=0.0)
    sac.optimizers["actor"].param_groups[0]["lr"] = 1e-3
    before = weights(sac.encoder), weights(sac.critics), weights(sac.actor)
    batch = random_batch()
    sac.update(batch, batch.task_reward, generator(), 0)
    assert torch.equal(weights(sac.encoder), before[0])
    assert torch.equal(weights(sac.critics), before[1])
    assert not torch.equal(weights(sac.actor), before[2])


def test_fitting_moves_the_policy_to_the_prior_alone():
    batch = random_batch()
    for prior in (None, torch.zeros(8, 8)):
        sac = make(learning_rate=1e-3)
        before = weights(sac.actor), sac.log_temperature.item(), weights(sac.critics)
        far = sac.gaussian(batch.image, batch.touch).square().mean()
        losses = sac.update(batch, batch.task_reward, generator(), 0, prior=prior, fitting=True)
        assert set(losses) == {"critic_loss", "value"}
        assert torch.equal(weights(sac.actor), before[0]) == (prior is None)
        assert sac.log_temperature.item() == before[1]
        assert not torch.equal(weights(sac.critics), before[2])
        for _ in range(20):
            sac.update(batch, batch.task_reward, generator(), 0, prior=prior, fitting=True)
    assert sac.gaussian(batch.image, batch.touch).square().mean() < far


def moved(sac, prior):
    """Return how far the mean action moves in 20 steps."""
    batch, noise = random_batch(), generator()
    before = torch.tanh(sac.gaussian(batch.image, batch.touch)[:, :4])
    for _ in range(20):
        sac.update(batch, torch.full((8,), 30.0), noise, 0, prior=prior)
    after = torch.tanh(sac.gaussian(batch.image, batch.touch)[:, :4])
    return float((after - before).square().sum(dim=1).mean())


def test_a_prior_keeps_the_policy_near_it_until_it_has_faded():
    distances = []
    for weight in (0.0, 100.0):
        sac, batch = make(), random_batch()
        prior = sac.gaussian(batch.image, batch.touch)
        sac.begin_phase(PhaseConfig(10, learning_rate=1e-3, prior_weight=weight, prior_steps=1))
        distances.append(moved(sac, prior))
    free, held = distances
    assert held < 0.3 * free
    phase = PhaseConfig(10, prior_weight=0.5, prior_steps=4)
    assert [phase.prior_weight_at(step) for step in (0, 2, 4, 9)] == [0.5, 0.25, 0.0, 0.0]


def test_divergence_is_that_of_the_two_gaussians():
    sac, batch = make(), random_batch()
    prior = sac.gaussian(batch.image, batch.touch)
    with torch.no_grad():
        sac.actor.mean.bias += 0.1
        sac.actor.log_std.bias -= 0.2
        features = sac.encoder(batch.image)
        now = sac.gaussian(batch.image, batch.touch)
        ours, theirs = (
            torch.distributions.Normal(mean, log_std.exp())
            for mean, log_std in (one.chunk(2, dim=1) for one in (now, prior))
        )
        expected = torch.distributions.kl_divergence(ours, theirs).sum(dim=1).mean()
        torch.testing.assert_close(sac._divergence_from(prior, features, batch.touch), expected)


def test_log_probability_is_that_of_the_squashed_gaussian():
    sac = make()
    features, touch = torch.randn(8, 256), torch.randn(8, 11)
    action, log_prob = sac._sample(features, touch, generator())
    mean, log_std = sac.actor.gaussian_of(features, touch)
    squashed = torch.distributions.TransformedDistribution(
        torch.distributions.Normal(mean, log_std.exp()), torch.distributions.TanhTransform()
    )
    expected = squashed.log_prob(action).sum(dim=1)
    torch.testing.assert_close(log_prob, expected, rtol=1e-4, atol=1e-4)


def test_a_shifted_picture_is_a_window_of_the_padded_one():
    image = random_batch(size=3).image
    assert shift_at_random(image, 0, generator()) is image
    padded = torch.nn.functional.pad(image.float(), (4,) * 4, mode="replicate")
    for row, shifted in enumerate(shift_at_random(image, 4, generator())):
        windows = [padded[row, :, y : y + 84, x : x + 84] for y in range(9) for x in range(9)]
        assert sum(torch.equal(shifted, window) for window in windows) == 1
