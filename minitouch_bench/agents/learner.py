"""Actor-critic and curiosity together: what acts, learns, and changes phase."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from minitouch_bench.agents.config import PhaseConfig, TrainingConfig
from minitouch_bench.agents.curiosity import Curiosity, find_curiosity
from minitouch_bench.agents.keypoints import Keypoints
from minitouch_bench.agents.memory import Batch, ReplayMemory
from minitouch_bench.agents.sac import Sac
from minitouch_bench.machine import processor_flags
from minitouch_bench.policies.networks import (
    ARCHITECTURES,
    KEYPOINT_FEATURES,
    TOUCH_SIZE,
    KeypointActor,
    TouchActor,
)
from minitouch_bench.policies.policy import IMAGE_SHAPE
from minitouch_bench.protocol.spec import TaskSpec, Workspace
from minitouch_bench.simulation.observation import FORCES, OPENINGS, POSITION, SENSED_TOUCH

FORCE_SCALE = 10.0
"""The finger force (N) that the networks see as 1."""


def has_bfloat16(device: torch.device) -> bool:
    """Tell whether a device multiplies in bfloat16, and not only emulates it.

    A gradient step of ``hac`` took 34 ms in place of 38 with ``avx512_bf16`` and no ``amx_bf16``.
    """
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    return "avx512_bf16" in processor_flags()


def _arrange(module: nn.Module, device: torch.device) -> None:
    """Move a module to a device, its convolutions in the order that is quickest there."""
    module.to(device)
    module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]


@contextmanager
def _weights_drawn_from(seed: int) -> Iterator[None]:
    """Draw first weights from a seed alone, and leave torch's own generator as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


def kept_size(action_size: int) -> int:
    """Return how many features of an observation a task phase on keypoints keeps."""
    return KEYPOINT_FEATURES + 2 * action_size


@dataclass(frozen=True)
class TouchScale:
    """Touch as networks see it: (touch - center) / half, both float32 (11,)."""

    center: Tensor
    half: Tensor

    @classmethod
    def of(cls, workspace: Workspace, device: torch.device) -> "TouchScale":
        """Map the workspace and the openings to -1 ... 1 and FORCE_SCALE to 1."""
        center, half = torch.zeros(TOUCH_SIZE), torch.ones(TOUCH_SIZE)
        low, high = torch.tensor(workspace.low), torch.tensor(workspace.high)
        center[POSITION], half[POSITION] = (low + high) / 2, (high - low) / 2
        center[OPENINGS], half[OPENINGS] = 0.5, 0.5
        half[FORCES] = FORCE_SCALE
        return cls(center.to(device), half.to(device))

    def scaled(self, touch: Tensor) -> Tensor:
        """Return touch float32 (N, 11) as the networks see it."""
        return (touch - self.center) / self.half

    @torch.no_grad()
    def fold_into(self, actor: TouchActor) -> None:
        """Change an actor on scaled touch into one on touch as the environment gives it."""
        weight = actor.first_layer.weight[:, -TOUCH_SIZE:]
        weight /= self.half.to(weight.device)
        actor.first_layer.bias.sub_(weight @ self.center.to(weight.device))


class Learner:
    """The networks of one training and their sources of chance."""

    def __init__(self, config: TrainingConfig, spec: TaskSpec, device: torch.device) -> None:
        self.config = config
        self.device = device
        half = has_bfloat16(device)
        sac = replace(config.sac, bfloat16=config.sac.bfloat16 and half)
        curiosity = replace(config.curiosity, bfloat16=config.curiosity.bfloat16 and half)
        self.exploring = config.exploration_steps > 0
        self.keypoints: Keypoints | None = None
        self.explorer: Sac | None = None
        self.curiosity: Curiosity | None = None
        with _weights_drawn_from(config.seed):
            self.sac = Sac(sac, action_size=spec.action_size)
            if config.method != "sac":
                self.curiosity = find_curiosity(config.method)(curiosity, spec.action_size)
                _arrange(self.curiosity, device)
                self.curiosity.begin()
        _arrange(self.sac, device)
        self.scale = TouchScale.of(spec.workspace, device)
        self.sac.begin_phase(self.phase)
        self.noise = torch.Generator(device).manual_seed(config.seed)
        self.rng = np.random.default_rng(config.seed)

    @property
    def phase(self) -> PhaseConfig:
        """Return the settings of the phase under way."""
        return self.config.exploration if self.exploring else self.config.task_phase

    @property
    def _is_blind(self) -> bool:
        return "vision" in self.phase.without

    def begin_task_phase(self, memory: ReplayMemory) -> None:
        """Learn from the task's reward from now on.

        With keypoints these are learned from the memory's images first. Actor and critics are new
        and see them; the actor is fitted to the exploration policy, the critics to the memory.
        """
        explored, self.exploring = self.exploring, False
        if not self.phase.keypoint_updates:
            self.sac.begin_phase(self.phase)
            return

        def draw(size: int) -> tuple[Tensor, Tensor]:
            image, touch = memory.sample_observations(self.rng, size)
            return image.to(self.device), self.scale.scaled(touch.to(self.device))

        keypoints = self._begin_keypoints(explored=explored)
        if self.phase.learns_keypoints:
            keypoints.learn(draw, self.phase.keypoint_updates)
        for _ in range(self.phase.fitting_updates):
            self.update(memory, 0, fitting=True)

    def _begin_keypoints(self, *, explored: bool) -> Keypoints:
        """Make the networks of a task phase that sees keypoints; keep those that ``explored``."""
        # Not seed + 1: the training with that seed starts from those weights.
        (seed,) = np.random.SeedSequence(self.config.seed).generate_state(1, np.uint64).tolist()
        before = self.sac
        with _weights_drawn_from(seed):
            keypoints = Keypoints()
            self.sac = Sac(
                replace(before.config, shift=0, target_encoder=False),
                action_size=before.action_size,
                encoder=nn.Identity(),
                features=KEYPOINT_FEATURES,
                layer_norm=True,
            )
        _arrange(keypoints, self.device)
        _arrange(self.sac, self.device)
        self.sac.begin_phase(self.phase)
        self.keypoints, self.explorer = keypoints, before if explored else None
        return keypoints

    def act(self, observation: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Return a stochastic action, float32 (A,)."""
        image, touch = (
            torch.from_numpy(observation[sense])[None].to(self.device)
            for sense in ("image", "touch")
        )
        action = self.sac.act(*self._seen(image, self.scale.scaled(touch)), self.noise)
        return action[0].numpy(force=True)

    def act_at_random(self) -> NDArray[np.float32]:
        """Return a uniformly random action, float32 (A,)."""
        return self.rng.uniform(-1.0, 1.0, self.sac.action_size).astype(np.float32)

    def update(
        self, memory: ReplayMemory, step: int, *, fitting: bool = False
    ) -> dict[str, Tensor]:
        """Draw a batch, and do one gradient step on the phase's reward.

        While exploring, the reward is the curiosity's, and the end of an episode is not terminal:
        a terminal end would remove all later reward and so punish success. No action follows an
        end in the memory, so the critics' estimate there is extrapolated.

        Args:
            memory: Memory to draw from.
            step: Control steps of the phase so far.
            fitting: Fit the actor to the exploration policy; in the task phase alone.

        Returns:
            The losses and other curves of the step, as scalars.
        """
        batch, losses = self._batch(memory), dict[str, Tensor]()
        if self.exploring and self.curiosity is not None:
            errors = self.curiosity.update(batch)
            reward = self.phase.reward_scale * self.curiosity.reward(errors.surprise)
            losses = {"curiosity_loss": errors.loss, "intrinsic_reward": reward.mean()}
        else:
            reward = self.phase.reward_scale * batch.task_reward
            batch = replace(batch, discount=batch.discount * ~batch.ended)
        prior = None if self.explorer is None else batch.image[:, KEYPOINT_FEATURES:]
        return losses | self.sac.update(
            self._sensed_batch(batch), reward, self.noise, step, prior=prior, fitting=fitting
        )

    def _sensed_batch(self, batch: Batch) -> Batch:
        """Return the batch as actor and critics see it."""
        image, touch = self._sensed(batch.image, batch.touch)
        next_image, next_touch = self._sensed(batch.next_image, batch.next_touch)
        if self.keypoints is not None:
            image, next_image = (seen[:, :KEYPOINT_FEATURES] for seen in (image, next_image))
        return replace(
            batch, image=image, touch=touch, next_image=next_image, next_touch=next_touch
        )

    def _seen(self, image: Tensor, touch: Tensor) -> tuple[Tensor, Tensor]:
        """Return images, or in a task phase keypoints, and scaled touch as the policy sees them."""
        image, touch = self._sensed(image, touch)
        if self.keypoints is not None and self._is_blind:
            image = touch.new_zeros((len(touch), KEYPOINT_FEATURES))
        elif self.keypoints is not None:
            image = self.keypoints.encode(image, touch)
        return image, touch

    def _sensed(
        self, image: Tensor, touch: Tensor, phase: PhaseConfig | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return images, or keypoints, and scaled touch with the senses that are left out at 0.

        ``phase``: the phase under way, unless another is given.
        """
        for sense in (phase or self.phase).without:
            if sense == "vision":
                image = torch.zeros_like(image)
            else:
                touch = touch.clone()
                touch[:, SENSED_TOUCH[sense]] = 0.0
        return image, touch

    def _batch(self, memory: ReplayMemory) -> Batch:
        if self.keypoints is not None:
            memory.encode(self._features)
        batch = memory.sample(
            self.rng,
            self.config.sac.batch_size,
            n_step=1 if self.exploring else self.phase.n_step,
            discount=self.config.sac.discount,
            success_share=self.phase.success_share,
            device=self.device,
            encoded=self.keypoints is not None,
        )
        return replace(
            batch,
            touch=self.scale.scaled(batch.touch),
            next_touch=self.scale.scaled(batch.next_touch),
        )

    def _features(self, image: Tensor, touch: Tensor) -> Tensor:
        """Return keypoints and the exploration policy's Gaussian, float32 (N, kept_size(A)).

        The Gaussian is 0 where there was no exploration.
        """
        image, touch = image.to(self.device), self.scale.scaled(touch.to(self.device))
        features, _ = self._seen(image, touch)
        if self.explorer is None:
            return functional.pad(features, (0, 2 * self.sac.action_size))
        prior = self.explorer.gaussian(*self._sensed(image, touch, self.config.exploration))
        return torch.cat((features, prior), dim=1)

    def actor(self) -> TouchActor:
        """Return the policy as it stands, on the CPU, scales folded in, weights in half precision.

        So a checkpoint of two bytes per weight is the policy that was evaluated. It ignores the
        senses that it learned without by its weights.
        """
        architecture, encoder = TouchActor.architecture, self.sac.encoder
        if self.keypoints is not None:
            architecture, encoder = KeypointActor.architecture, self.keypoints.encoder
        learned = {f"encoder.{name}": value for name, value in encoder.state_dict().items()}
        actor = ARCHITECTURES[architecture](self.sac.action_size, self.config.sac.encoder_width)
        actor.load_state_dict(learned | self.sac.actor.state_dict())
        self._fold_constants(actor)
        self.scale.fold_into(actor)
        return actor.half().float()

    @torch.no_grad()
    def _fold_constants(self, actor: TouchActor) -> None:
        """Move what a constant sense adds to the first layer into its bias."""
        weight, bias = actor.first_layer.weight, actor.first_layer.bias
        if self._is_blind:
            if self.keypoints is None:  # whose coordinates would be 0
                black = torch.zeros(1, *IMAGE_SHAPE, dtype=torch.uint8)
                bias.add_(weight[:, :-TOUCH_SIZE] @ actor.encoder(black)[0])
            weight[:, :-TOUCH_SIZE] = 0.0
        if self.keypoints is not None:
            self.keypoints.fold_into(actor)
        for sense, part in SENSED_TOUCH.items():
            if sense in self.phase.without:
                weight[:, -TOUCH_SIZE:][:, part] = 0.0

    def _parts(self) -> dict[str, Any]:
        """Return the modules and optimizers that learn; each has a ``state_dict``."""
        parts: dict[str, Any] = {"sac": self.sac, **self.sac.optimizers}
        if self.curiosity is not None:
            parts |= {"curiosity": self.curiosity, "surprise": self.curiosity.optimizer}
        if self.keypoints is not None:
            parts["keypoints"] = self.keypoints
        if self.explorer is not None:
            parts["explorer"] = self.explorer
        return parts

    def state(self) -> dict[str, Any]:
        """Return everything that later steps depend on."""
        return {
            "exploring": self.exploring,
            "noise": self.noise.get_state(),
            "rng": self.rng.bit_generator.state,
            "parts": {name: part.state_dict() for name, part in self._parts().items()},
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Go on from what ``state`` returned."""
        self.exploring, states = state["exploring"], state["parts"]
        self.sac.begin_phase(self.phase)
        if "keypoints" in states:
            self._begin_keypoints(explored="explorer" in states)
        for name, part in self._parts().items():
            part.load_state_dict(states[name])
        self.noise.set_state(state["noise"].cpu())
        self.rng.bit_generator.state = state["rng"]
