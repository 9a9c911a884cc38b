"""Curiosity: models that learn from batches, and rewards from their surprise, by method."""

import hashlib
import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.memory import Batch
from minitouch_bench.agents.sac import encode_image
from minitouch_bench.errors import PolicyLoadError, UsageError
from minitouch_bench.machine import look_up_own
from minitouch_bench.policies.networks import (
    FEATURES,
    HIDDEN_UNITS,
    TOUCH_SIZE,
    ImageConvolutions,
    VisualEncoder,
)
from minitouch_bench.policies.policy import IMAGE_SHAPE
from minitouch_bench.simulation.observation import FORCES

WHITENED_LIMIT = 5.0
"""Standard deviations."""

ENSEMBLE_SIZE = 5
"""Models in the ensemble (Pathak et al. 2019)."""

FIXED_TARGET_PACE = 10 / 3
"""For models of what a random network says: at the learning rate of the others, 0.0003, what a
policy saw most surprised them as much as what it never saw (experiments/notebook.md)."""

DISTILLED = 512
"""Numbers that the target network gives (Burda et al. 2019)."""


@dataclass(frozen=True)
class Errors:
    """What a model got wrong about a batch, before it learned from it.

    ``surprise`` float32 (N,), >= 0: how new each transition is. ``loss``: a scalar.
    """

    surprise: Tensor
    loss: Tensor


class Curiosity(nn.Module, ABC):
    """What an agent has learned from, paid where a transition is new to it.

    A subclass says what surprises it (``errors``), and there updates what it learns without
    gradients. What it learns is a parameter or a buffer, so that checkpoints hold it. Batches are
    one control step long and hold normalized touch.

    The reward comes from the same pass as the loss, so from the weights before the gradient step:
    another pass costs as much again as the loss, and one gradient step changes it little.

    ``window``: over how many batches, the latest ones, the rewards' standard deviation is taken.
    A model's first surprises can be a thousand times its later ones: were they never forgotten,
    the reward would stay near 0. ``pace``: how many times the config's learning rate.
    """

    window: ClassVar[float] = 100
    pace: ClassVar[float] = 1.0

    def __init__(self, config: CuriosityConfig) -> None:
        super().__init__()
        self.config = config
        self.seen: Tensor = nn.Buffer(torch.zeros((), dtype=torch.float64))
        self.mean: Tensor = nn.Buffer(torch.zeros((), dtype=torch.float64))
        self.squares: Tensor = nn.Buffer(torch.zeros((), dtype=torch.float64))

    def begin(self) -> None:
        """Make the optimizer, once everything is in place on its device."""
        # As a group, which may be empty: a model need not have a network.
        trained = {"params": [weights for weights in self.parameters() if weights.requires_grad]}
        self.optimizer = torch.optim.Adam(
            [trained], self.pace * self.config.learning_rate, fused=True
        )

    @abstractmethod
    def errors(self, batch: Batch) -> Errors:
        """Return how new each transition is, and the networks' loss with its gradients."""

    def update(self, batch: Batch) -> Errors:
        """Learn from a batch, by one gradient step, and return the errors before it.

        Raises:
            UsageError: a class of the user's gives surprises of another shape.
        """
        errors = self.errors(batch)
        if errors.surprise.shape != batch.task_reward.shape:
            given, name = tuple(errors.surprise.shape), type(self).__name__
            raise UsageError(f"{name}.errors gives a surprise of shape {given}, not one per row")
        if errors.loss.requires_grad:
            self.optimizer.zero_grad()
            errors.loss.backward()  # type: ignore[no-untyped-call]
            self.optimizer.step()
        return Errors(errors.surprise.detach(), errors.loss.detach())

    @torch.no_grad()
    def reward(self, surprise: Tensor) -> Tensor:
        """Return the intrinsic reward of transitions, float32 (N,), from how new they are.

        With ``normalize`` it is divided by the standard deviation of about the last ``window``
        batches of surprises.
        """
        if not self.config.normalize:
            return surprise
        self._count(surprise.double())
        deviation = (self.squares / self.seen).sqrt().float()
        return surprise / (deviation + 1e-8)

    def _count(self, values: Tensor) -> None:
        """Add values to the running mean and variance (Chan et al.), and forget the oldest."""
        count = len(values)
        total = self.seen + count
        delta = values.mean() - self.mean
        self.squares += values.var(correction=0) * count + delta**2 * self.seen * count / total
        self.mean += delta * count / total
        self.seen += count
        kept = torch.clamp(self.window * count / self.seen, max=1.0)
        self.squares *= kept
        self.seen *= kept

    def encode(self, encoder: nn.Module, image: Tensor) -> Tensor:
        """Return features of images, float32 (N, F)."""
        return encode_image(encoder, image, bfloat16=self.config.bfloat16)


class Whitening(nn.Module):
    """Subtract each number's mean over all batches seen, and divide by its standard deviation.

    The result is clipped to WHITENED_LIMIT (Burda et al. 2019). A random network distinguishes
    images whose pixels are whitened; of raw ones it sees the background, which is the same in all.

    Args:
        shape: Of one image, or of its features.
        least_deviation: Standard deviation of a number that varies less, in its unit.
    """

    def __init__(self, shape: tuple[int, ...], least_deviation: float) -> None:
        super().__init__()
        self.least_variance = least_deviation**2
        self.count: Tensor = nn.Buffer(torch.zeros(()))
        self.mean: Tensor = nn.Buffer(torch.zeros(shape))
        self.square: Tensor = nn.Buffer(torch.zeros(shape))

    @torch.no_grad()
    def watch(self, batch: Tensor) -> None:
        """Add a batch (N, *shape) to the running mean and mean square of each number."""
        values = batch.float()
        self.count += len(values)
        rate = len(values) / self.count
        self.mean += rate * (values.mean(dim=0) - self.mean)
        self.square += rate * (values.square().mean(dim=0) - self.square)

    def forward(self, batch: Tensor) -> Tensor:
        """Return a whitened batch, float32 (N, *shape)."""
        variance = (self.square - self.mean.square()).clamp_min(self.least_variance)
        whitened = (batch.float() - self.mean) / variance.sqrt()
        return whitened.clamp(-WHITENED_LIMIT, WHITENED_LIMIT)


def initialize(module: nn.Module) -> None:
    """Give a layer orthogonal weights of gain sqrt(2) and no bias (Burda et al. 2019)."""
    if isinstance(module, nn.Conv2d | nn.Linear):
        nn.init.orthogonal_(module.weight, math.sqrt(2.0))
        assert module.bias is not None
        nn.init.zeros_(module.bias)


def two_layers(inputs: int, outputs: int) -> nn.Sequential:
    """Return a head with two hidden layers of 128 units (supplement, Table 2)."""
    return nn.Sequential(
        nn.Linear(inputs, HIDDEN_UNITS),
        nn.LeakyReLU(),
        nn.Linear(HIDDEN_UNITS, HIDDEN_UNITS),
        nn.LeakyReLU(),
        nn.Linear(HIDDEN_UNITS, outputs),
    )


class HapticCuriosity(Curiosity):
    """Predict the finger forces of the reached state from its image.

    r = mean_k (f_k(x') - tanh h'_k)^2, where x' is the image and h' the forces of the reached
    state in units of FORCE_SCALE, both from the same moment (supplement, Figure 8: the agent
    "anticipates the force/torque sensation" of what it sees).

    Decisions, where the paper is silent:

    - Forces alone are predicted: position and opening are seen in every image.
    - tanh: an image shows whether a finger touches, but not how hard it presses, so without tanh
      the reward is largest where the fingers press hardest (experiments/notebook.md).
    - The standard deviation is that of all surprises, which grow as the policy finds contacts.
    """

    window = math.inf

    def __init__(self, config: CuriosityConfig, _action_size: int) -> None:
        super().__init__(config)
        self.encoder = VisualEncoder(config.width)
        self.head = two_layers(FEATURES, 6)

    def errors(self, batch: Batch) -> Errors:
        """Return squared errors; the loss is their mean."""
        prediction = self.head(self.encode(self.encoder, batch.next_image))
        surprise = (prediction - batch.next_touch[:, FORCES].tanh()).square().mean(dim=1)
        return Errors(surprise, surprise.mean())


class InverseDynamics(Curiosity):
    """Predict the next features; learn the features by telling which action was done.

    r = mean_k (g(phi(x), a)_k - phi(x')_k)^2; phi learns through the inverse model
    a ~ h(phi(x), phi(x')) alone (Pathak et al. 2017, Burda et al. 2019: large-scale-curiosity).
    """

    uses_touch = False

    def __init__(self, config: CuriosityConfig, action_size: int) -> None:
        super().__init__(config)
        state = FEATURES + (TOUCH_SIZE if self.uses_touch else 0)
        self.encoder = VisualEncoder(config.width)
        self.inverse = two_layers(2 * FEATURES, action_size)
        self.forward_model = two_layers(state + action_size, state)

    def errors(self, batch: Batch) -> Errors:
        """Return the forward model's squared errors; the loss adds the inverse model's."""
        now = self.encode(self.encoder, batch.image)
        then = self.encode(self.encoder, batch.next_image)
        guessed = self.inverse(torch.cat((now, then), dim=1))
        inverse = functional.mse_loss(guessed, batch.action)
        now, then = now.detach(), then.detach()
        if self.uses_touch:
            now = torch.cat((now, batch.touch), dim=1)
            then = torch.cat((then, batch.next_touch), dim=1)
        predicted = self.forward_model(torch.cat((now, batch.action), dim=1))
        surprise = (predicted - then).square().mean(dim=1)
        return Errors(surprise, inverse + surprise.mean())


class TouchInverseDynamics(InverseDynamics):
    """The same with (phi(x), touch) as the state, so that the next touch is predicted as well.

    Source: the supplement's "touch in future prediction".
    """

    uses_touch = True


class Disagreement(Curiosity):
    """Predict the next features with five models; pay where they differ.

    r = mean_k var_m g_m(phi(x), a)_k (Pathak et al. 2019, exploration-by-disagreement).
    phi is a random encoder of whitened images that is never trained: their simplest choice. Each
    feature is whitened too: otherwise the models fit so little of the features, which mostly show
    where the arm is, that they differ most where the image varies most, however often it was seen.
    """

    pace = FIXED_TARGET_PACE

    def __init__(self, config: CuriosityConfig, action_size: int) -> None:
        super().__init__(config)
        self.whitening = Whitening(IMAGE_SHAPE, least_deviation=1.0)
        self.feature_whitening = Whitening((FEATURES,), least_deviation=1e-3)
        self.encoder = VisualEncoder(config.width).apply(initialize).requires_grad_(False)
        self.members = nn.ModuleList(
            two_layers(FEATURES + action_size, FEATURES) for _ in range(ENSEMBLE_SIZE)
        )

    def errors(self, batch: Batch) -> Errors:
        """Return the variance of the predictions; the loss is every member's squared error."""
        self.whitening.watch(batch.next_image)
        now, then = (
            self.encode(self.encoder, self.whitening(image))
            for image in (batch.image, batch.next_image)
        )
        self.feature_whitening.watch(then)
        now, then = self.feature_whitening(now), self.feature_whitening(then)
        seen = torch.cat((now, batch.action), dim=1)
        predictions = torch.stack([member(seen) for member in self.members])
        variance = predictions.detach().var(dim=0, correction=0)
        return Errors(variance.mean(dim=1), (predictions - then).square().mean())


class RandomDistillation(Curiosity):
    """Predict what a fixed random network says of the reached state.

    r = mean_k (f(o')_k - t(o')_k)^2, t random and fixed, o' the whitened image (Burda et
    al. 2019). Convolutions of 32, 64 and 64 channels as theirs, times ``width``; the predictor
    is two layers deeper. It does not depend on actions.
    """

    uses_touch = False
    pace = FIXED_TARGET_PACE

    def __init__(self, config: CuriosityConfig, _action_size: int) -> None:
        super().__init__(config)
        self.target_maps = _convolutions(config.width).requires_grad_(False)
        flat = self.target_maps(torch.zeros(1, *IMAGE_SHAPE)).shape[1]
        inputs = flat + (TOUCH_SIZE if self.uses_touch else 0)
        self.target_head: nn.Module = nn.Linear(inputs, DISTILLED)
        if self.uses_touch:  # no convolution sees it: one layer alone would map it linearly
            deeper = nn.ReLU(), nn.Linear(DISTILLED, DISTILLED)
            self.target_head = nn.Sequential(self.target_head, *deeper)
        self.target_head.requires_grad_(False)
        self.maps = _convolutions(config.width)
        self.hidden = nn.Sequential(
            nn.Linear(inputs, DISTILLED), nn.ReLU(), nn.Linear(DISTILLED, DISTILLED), nn.ReLU()
        )
        self.head = nn.Linear(DISTILLED, DISTILLED)
        self.whitening = Whitening(IMAGE_SHAPE, least_deviation=1.0)
        self.apply(initialize)

    def errors(self, batch: Batch) -> Errors:
        """Learn the pixels' statistics, and return the predictor's squared errors."""
        self.whitening.watch(batch.next_image)
        image = self.whitening(batch.next_image)
        target: Tensor = self.target_head(self._seen(self.target_maps, image, batch.next_touch))
        seen = self._seen(self.maps, image, batch.next_touch)
        guess: Tensor = self.head(self.encode(self.hidden, seen))
        surprise = (guess - target).square().mean(dim=1)
        return Errors(surprise, surprise.mean())

    def _seen(self, maps: nn.Module, image: Tensor, touch: Tensor) -> Tensor:
        features = self.encode(maps, image)
        if not self.uses_touch:
            return features
        weight = (features.shape[1] / TOUCH_SIZE) ** 0.5
        return torch.cat((features, weight * touch), dim=1)


class TouchDistillation(RandomDistillation):
    """The same on image features and touch, concatenated as the input of both networks.

    The supplement (7.5) says no more. Ours: touch is multiplied by sqrt(features / touch numbers),
    so that the few numbers change the target about as much as the many features do. The target
    has a hidden layer after them: without it touch would be mapped linearly, and new touch hardly
    be new.
    """

    uses_touch = True


def _convolutions(width: float) -> ImageConvolutions:
    first, second, third = (max(1, int(width * channels)) for channels in (32, 64, 64))
    return ImageConvolutions(
        nn.Conv2d(1, first, 8, 4), nn.LeakyReLU(),
        nn.Conv2d(first, second, 4, 2), nn.LeakyReLU(),
        nn.Conv2d(second, third, 3, 1), nn.LeakyReLU(),
        nn.Flatten(),
    )  # fmt: skip


CURIOSITIES: Mapping[str, Callable[[CuriosityConfig, int], Curiosity]] = {
    "hac": HapticCuriosity,
    "icm": InverseDynamics,
    "icm-touch": TouchInverseDynamics,
    "disagreement": Disagreement,
    "rnd": RandomDistillation,
    "rnd-touch": TouchDistillation,
}
"""The curiosity of every method but ``sac``, which has none."""


def find_curiosity(method: str) -> Callable[[CuriosityConfig, int], Curiosity]:
    """Return the curiosity of a method; a class of the user's is imported, which runs its code.

    Raises:
        UsageError: it cannot be imported, or is not a whole subclass of Curiosity.
    """
    if method in CURIOSITIES:
        return CURIOSITIES[method]
    try:
        found = look_up_own(method)
    except PolicyLoadError as error:
        raise UsageError(f"the method {method}: {error}") from error
    if not (inspect.isclass(found) and issubclass(found, Curiosity)) or inspect.isabstract(found):
        base = f"{Curiosity.__module__}:{Curiosity.__name__}"
        raise UsageError(f"{method} is not a subclass of {base} with a method errors")
    return found


def digest_method(method: str) -> str:
    """Return the SHA-256 of the source file of the user's class, "" for a method of ours."""
    if ":" not in method:
        return ""
    source = inspect.getsourcefile(find_curiosity(method))
    assert source is not None
    return hashlib.sha256(Path(source).read_bytes()).hexdigest()
