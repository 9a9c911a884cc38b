"""Soft actor-critic (Haarnoja et al. 2018) on image and touch, with one shared encoder.

The critics' loss trains the encoder; the actor reads its features and leaves it alone (Yarats
et al. 2021). Images can be shifted at random before each use (DrQ, Kostrikov et al. 2021). Or there
is no encoder, and both see the coordinates of keypoints, which something else has learned.

In a task phase after an exploration the actor's loss has two more terms, so that the policy does
not leave what curiosity found while the task's new critics are wrong: the divergence from the
exploration policy, as in KL-regularized reinforcement learning (Galashov et al. 2019), and the
imitation of actions that led to a success where the critics value them above the policy's (Nair et
al. 2018, "Q filter"). Layer norm in the critics follows RLPD (Ball et al. 2023).
"""

import copy
import math

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from minitouch_bench.agents.config import PhaseConfig, SacConfig
from minitouch_bench.agents.replay import Batch
from minitouch_bench.policies.networks import (
    FEATURES,
    HIDDEN_UNITS,
    KEYPOINT_FEATURES,
    TOUCH_SIZE,
    TouchActor,
    VisualEncoder,
)

LEAST_PRIOR_LOG_STD = -3.0
"""Clamp on the prior's log standard deviation: where the exploration policy was nearly
deterministic, the policy need not be."""

MOST_DIVERGENCE = 20.0
"""Nats of one state; beyond them the divergence has no gradient."""


class TwoCritics(nn.Module):
    """Two estimates of the value of features, touch and action (supplement, Table 2)."""

    def __init__(self, inputs: int, *, layer_norm: bool) -> None:
        super().__init__()
        self.first, self.second = (_critic(inputs, layer_norm=layer_norm) for _ in range(2))

    def forward(self, features: Tensor, touch: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return both values, float32 (N,)."""
        joined = torch.cat((features, touch, action), dim=1)
        return self.first(joined)[:, 0], self.second(joined)[:, 0]


def _critic(inputs: int, *, layer_norm: bool) -> nn.Sequential:
    layers: list[nn.Module] = []
    for size in (inputs, HIDDEN_UNITS):
        layers.append(nn.Linear(size, HIDDEN_UNITS))
        if layer_norm:
            layers.append(nn.LayerNorm(HIDDEN_UNITS))
        layers.append(nn.LeakyReLU())
    return nn.Sequential(*layers, nn.Linear(HIDDEN_UNITS, 1))


class Prior(nn.Module):
    """A policy that another one stays near, as it was when it was kept."""

    def __init__(self, encoder: nn.Module, actor: TouchActor) -> None:
        super().__init__()
        self.encoder, self.actor = encoder, actor
        self.requires_grad_(False)


class Sac(nn.Module):
    """The networks of both phases, their optimizers, and one gradient step."""

    def __init__(
        self,
        config: SacConfig,
        *,
        action_size: int,
        touch_size: int = TOUCH_SIZE,
        encoder: nn.Module | None = None,
        features: int = FEATURES,
        sees_keypoints: bool = False,
    ) -> None:
        super().__init__()
        self.config = config
        self.action_size = action_size
        self.sees_keypoints = sees_keypoints
        if sees_keypoints:
            encoder, features = nn.Identity(), KEYPOINT_FEATURES
        self.encoder = encoder or VisualEncoder(config.encoder_width)
        self.actor = TouchActor(
            action_size, encoder=nn.Identity(), features=features, touch_size=touch_size
        )
        self._critic_inputs = features + touch_size + action_size
        self.critics = TwoCritics(self._critic_inputs, layer_norm=False)
        followed = self.encoder if config.target_encoder else nn.Identity()
        self.target_encoder = copy.deepcopy(followed).requires_grad_(False)
        self.target_critics = copy.deepcopy(self.critics).requires_grad_(False)
        self.log_temperature = nn.Parameter(torch.zeros(()))
        self.prior: Prior | None = None

    def keep_prior(self, explored: "Sac") -> None:
        """Keep the policy of ``explored``, often these networks' own, as the prior; renew critics.

        The new critics have layer norm.
        """
        self.prior = Prior(copy.deepcopy(explored.encoder), copy.deepcopy(explored.actor))
        self.critics = TwoCritics(self._critic_inputs, layer_norm=True)
        self.target_critics = copy.deepcopy(self.critics).requires_grad_(False)

    def begin_phase(self, phase: PhaseConfig) -> None:
        """Take a phase's settings, with fresh optimizers."""
        self.phase = phase
        with torch.no_grad():
            self.log_temperature.fill_(math.log(phase.initial_temperature))
        rate = phase.learning_rate
        self.critic_optimizer = torch.optim.Adam(
            [*self.encoder.parameters(), *self.critics.parameters()], rate, fused=True
        )
        self.actor_optimizer = torch.optim.Adam(
            [*self.actor.parameters(), self.log_temperature], rate, fused=True
        )

    def optimizers(self) -> dict[str, torch.optim.Optimizer]:
        """Return the optimizers by name."""
        return {"critic": self.critic_optimizer, "actor": self.actor_optimizer}

    @torch.no_grad()
    def act(self, image: Tensor, touch: Tensor, generator: torch.Generator) -> Tensor:
        """Return stochastic actions float32 (N, A) in (-1, 1)."""
        return self._sample(self._encode(self.encoder, image), touch, generator)[0]

    def update(
        self,
        batch: Batch,
        reward: Tensor,
        generator: torch.Generator,
        step: int,
        *,
        critics_only: bool = False,
    ) -> dict[str, Tensor]:
        """Do one gradient step of critics, actor, temperature and targets.

        ``reward`` float32 (N,), of the whole transition. ``step``: control steps of the phase so
        far. ``critics_only`` leaves actor and temperature as they are. Returns the losses and what
        else is worth a curve, as scalars.
        """
        alpha = self.log_temperature.detach().exp()
        image, next_image = self._seen(batch, generator)
        features = self._encode(self.encoder, image)

        with torch.no_grad():
            next_features = self._encode(self.encoder, next_image)
            next_action, next_log_prob = self._sample(next_features, batch.next_touch, generator)
            if self.config.target_encoder:
                next_features = self._encode(self.target_encoder, next_image)
            next_values = self.target_critics(next_features, batch.next_touch, next_action)
            next_value = torch.minimum(*next_values) - alpha * next_log_prob
            target = reward + batch.discount * next_value

        first, second = self.critics(features, batch.touch, batch.action)
        critic_loss = functional.mse_loss(first, target) + functional.mse_loss(second, target)
        _step(self.critic_optimizer, critic_loss)
        losses = {"critic_loss": critic_loss.detach(), "value": first.detach().mean()}
        if critics_only:
            if self.sees_keypoints and self.prior is not None:
                self._fit_to(self.prior, features, batch)
            self._follow()
            return losses

        features = features.detach()
        action, log_prob = self._sample(features, batch.touch, generator)
        value = torch.minimum(*self._frozen_critics(features, batch.touch, action))
        actor_loss = (alpha * log_prob - value).mean()
        if self.phase.imitation:
            recorded = (first + second).detach() / 2.0
            better = batch.led_to_success & (recorded > value.detach())
            distance = (action - batch.action).square().sum(dim=1)
            actor_loss = actor_loss + self.phase.imitation * (better * distance).mean()
        if self.prior is not None and (weight := self.phase.prior_weight_at(step)):
            divergence = self._divergence_from(self.prior, features, batch)
            actor_loss = actor_loss + weight * divergence
        entropy = -log_prob.detach().mean()
        missing = self.phase.target_entropy_at(step) * self.action_size - entropy
        _step(self.actor_optimizer, actor_loss - self.log_temperature * missing)

        self._follow()
        return losses | {
            "actor_loss": actor_loss.detach(),
            "entropy": entropy,
            "temperature": alpha,
        }

    def _fit_to(self, prior: Prior, features: Tensor, batch: Batch) -> None:
        """Move the actor's mean and log standard deviation towards the prior's."""
        mean, log_std = self.actor.gaussian_of(features.detach(), batch.touch)
        prior_mean, prior_log_std = self._gaussian_of(prior, batch)
        loss = functional.mse_loss(mean, prior_mean) + functional.mse_loss(log_std, prior_log_std)
        _step(self.actor_optimizer, loss)

    @torch.no_grad()
    def _gaussian_of(self, prior: Prior, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return the prior's mean and log standard deviation, each float32 (N, A)."""
        seen = self._encode(prior.encoder, batch.image)
        mean, log_std = prior.actor.gaussian_of(seen, batch.touch)
        return mean, log_std.clamp_min(LEAST_PRIOR_LOG_STD)

    def _divergence_from(self, prior: Prior, features: Tensor, batch: Batch) -> Tensor:
        """Return the batch's mean KL(policy, prior) in nats, before squashing, each capped."""
        mean, log_std = self.actor.gaussian_of(features, batch.touch)
        prior_mean, prior_log_std = self._gaussian_of(prior, batch)
        square = (2.0 * log_std).exp() + (mean - prior_mean).square()
        ratio = square / (2.0 * (2.0 * prior_log_std).exp())
        divergence = (prior_log_std - log_std + ratio - 0.5).sum(dim=1)
        return divergence.clamp_max(MOST_DIVERGENCE).mean()

    def _sample(
        self, features: Tensor, touch: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return squashed actions (N, A) and their log probabilities (N,)."""
        mean, log_std = self.actor.gaussian_of(features, touch)
        noise = torch.randn(mean.shape, generator=generator, device=mean.device)
        raw = mean + log_std.exp() * noise
        normal = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi)
        # log(1 - tanh(x)^2) without its cancellation
        squash = 2.0 * (math.log(2.0) - raw - functional.softplus(-2.0 * raw))
        return torch.tanh(raw), (normal - squash).sum(dim=1)

    def _frozen_critics(
        self, features: Tensor, touch: Tensor, action: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the critics' values without gradients for the critics themselves."""
        self.critics.requires_grad_(False)
        values: tuple[Tensor, Tensor] = self.critics(features, touch, action)
        self.critics.requires_grad_(True)
        return values

    def _encode(self, encoder: nn.Module, image: Tensor) -> Tensor:
        return encode(encoder, image, bfloat16=self.config.bfloat16)

    def _seen(self, batch: Batch, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return what the encoder gets of both observations: coordinates, or shifted images."""
        if self.sees_keypoints:
            return batch.features, batch.next_features
        first, second = (
            shift_at_random(image, self.config.shift, generator)
            for image in (batch.image, batch.next_image)
        )
        return first, second

    @torch.no_grad()
    def _follow(self) -> None:
        """Move the target networks a little towards the trained ones."""
        for target, source in (
            (self.target_critics, self.critics),
            (self.target_encoder, self.encoder),
        ):
            targets: list[Tensor] = list(target.parameters())
            sources: list[Tensor] = list(source.parameters())
            if targets:
                torch._foreach_lerp_(targets, sources, self.config.target_rate)


def encode(encoder: nn.Module, image: Tensor, *, bfloat16: bool) -> Tensor:
    """Return the features of images, float32 (N, F), computed in half precision if asked."""
    with torch.autocast(image.device.type, torch.bfloat16, enabled=bfloat16):
        features: Tensor = encoder(image)
    return features.float()


def shift_at_random(image: Tensor, pixels: int, generator: torch.Generator) -> Tensor:
    """Return each image (N, 1, H, W) shifted by up to ``pixels``, its edge repeated."""
    if pixels == 0:
        return image
    count, _, height, width = image.shape
    up, left = torch.randint(
        2 * pixels + 1, (2, count), generator=generator, device=image.device
    ).numpy(force=True)
    beyond = ((0, 0), (0, 0), (pixels, pixels), (pixels, pixels))
    padded = np.pad(image.numpy(force=True), beyond, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (height, width), (2, 3))
    return torch.from_numpy(windows[np.arange(count), :, up, left]).to(image.device)


def _step(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()
