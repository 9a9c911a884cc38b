"""Soft actor-critic (Haarnoja et al. 2018) on image and touch, with one shared encoder.

The critics' loss trains the encoder; the actor reads its features and leaves it alone (Yarats
et al. 2021). Images can be shifted at random before each use (DrQ, Kostrikov et al. 2021). Or there
is no encoder, and both see features that something else has learned.

The actor's loss can have one more term, so that the policy does not leave what curiosity found
while the task's new critics are wrong: the divergence from the exploration policy, as in
KL-regularized reinforcement learning (Galashov et al. 2019). Layer norm in the critics follows
RLPD (Ball et al. 2023).
"""

import copy
import math

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from minitouch_bench.agents.config import PhaseConfig, SacConfig
from minitouch_bench.agents.memory import Batch
from minitouch_bench.policies.networks import (
    FEATURES,
    HIDDEN_UNITS,
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


class Sac(nn.Module):
    """The networks, their optimizers, and one gradient step."""

    def __init__(
        self,
        config: SacConfig,
        *,
        action_size: int,
        touch_size: int = TOUCH_SIZE,
        encoder: nn.Module | None = None,
        features: int = FEATURES,
        layer_norm: bool = False,
    ) -> None:
        super().__init__()
        self.config = config
        self.action_size = action_size
        self.encoder = encoder or VisualEncoder(config.encoder_width)
        self.actor = TouchActor(
            action_size, encoder=nn.Identity(), features=features, touch_size=touch_size
        )
        self.critics = TwoCritics(features + touch_size + action_size, layer_norm=layer_norm)
        followed = self.encoder if config.target_encoder else nn.Identity()
        self.target_encoder = copy.deepcopy(followed).requires_grad_(False)
        self.target_critics = copy.deepcopy(self.critics).requires_grad_(False)
        self.log_temperature = nn.Parameter(torch.zeros(()))

    def begin_phase(self, phase: PhaseConfig) -> None:
        """Take a phase's settings, with fresh optimizers."""
        self.phase = phase
        with torch.no_grad():
            self.log_temperature.fill_(math.log(phase.initial_temperature))
        learned = {
            "critic": [*self.encoder.parameters(), *self.critics.parameters()],
            "actor": [*self.actor.parameters(), self.log_temperature],
        }
        self.optimizers = {
            name: torch.optim.Adam(weights, phase.learning_rate, fused=True)
            for name, weights in learned.items()
        }

    @torch.no_grad()
    def act(self, image: Tensor, touch: Tensor, generator: torch.Generator) -> Tensor:
        """Return stochastic actions float32 (N, A) in (-1, 1)."""
        return self._sample(self._encode(self.encoder, image), touch, generator)[0]

    @torch.no_grad()
    def gaussian(self, image: Tensor, touch: Tensor) -> Tensor:
        """Return the policy's mean and log standard deviation side by side, float32 (N, 2 A)."""
        return torch.cat(self.actor.gaussian_of(self._encode(self.encoder, image), touch), dim=1)

    def update(
        self,
        batch: Batch,
        reward: Tensor,
        generator: torch.Generator,
        step: int,
        *,
        prior: Tensor | None = None,
        fitting: bool = False,
    ) -> dict[str, Tensor]:
        """Do one gradient step of critics, actor, temperature and targets.

        ``reward`` float32 (N,), of the whole transition. ``step``: control steps of the phase so
        far. ``prior``: what ``gaussian`` of the exploration policy returned for the batch.
        ``fitting``: the actor is fitted to the prior, if there is one, and not to the critics'
        values. Returns the losses and what else is worth a curve, as scalars.
        """
        alpha = self.log_temperature.detach().exp()
        image = shift_at_random(batch.image, self.config.shift, generator)
        next_image = shift_at_random(batch.next_image, self.config.shift, generator)
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
        _step(self.optimizers["critic"], critic_loss)
        losses = {"critic_loss": critic_loss.detach(), "value": first.detach().mean()}
        features = features.detach()
        if fitting:
            if prior is not None:
                distance = self._distance_from(prior, features, batch.touch)
                _step(self.optimizers["actor"], distance)
            self._follow()
            return losses

        action, log_prob = self._sample(features, batch.touch, generator)
        value = torch.minimum(*self.critics(features, batch.touch, action))
        actor_loss = (alpha * log_prob - value).mean()
        if prior is not None and (weight := self.phase.prior_weight_at(step)):
            divergence = self._divergence_from(prior, features, batch.touch)
            actor_loss = actor_loss + weight * divergence
        entropy = -log_prob.detach().mean()
        missing = self.phase.target_entropy_at(step) * self.action_size - entropy
        _step(self.optimizers["actor"], actor_loss - self.log_temperature * missing)

        self._follow()
        return losses | {
            "actor_loss": actor_loss.detach(),
            "entropy": entropy,
            "temperature": alpha,
        }

    def _distance_from(self, prior: Tensor, features: Tensor, touch: Tensor) -> Tensor:
        """Return the squared distance of means and log standard deviations."""
        mean, log_std = self.actor.gaussian_of(features, touch)
        prior_mean, prior_log_std = _mean_and_log_std(prior)
        return functional.mse_loss(mean, prior_mean) + functional.mse_loss(log_std, prior_log_std)

    def _divergence_from(self, prior: Tensor, features: Tensor, touch: Tensor) -> Tensor:
        """Return the batch's mean KL(policy, prior) in nats, before squashing, each capped."""
        mean, log_std = self.actor.gaussian_of(features, touch)
        prior_mean, prior_log_std = _mean_and_log_std(prior)
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

    def _encode(self, encoder: nn.Module, image: Tensor) -> Tensor:
        return encode_image(encoder, image, bfloat16=self.config.bfloat16)

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


def _mean_and_log_std(prior: Tensor) -> tuple[Tensor, Tensor]:
    mean, log_std = prior.chunk(2, dim=1)
    return mean, log_std.clamp_min(LEAST_PRIOR_LOG_STD)


def encode_image(encoder: nn.Module, image: Tensor, *, bfloat16: bool) -> Tensor:
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
    """Do a gradient step of the optimizer's own parameters; others get no gradient."""
    own = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    optimizer.zero_grad()
    loss.backward(inputs=own)  # type: ignore[no-untyped-call]
    optimizer.step()
