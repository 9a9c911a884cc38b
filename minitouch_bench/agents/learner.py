"""Actor-critic and curiosity together: what acts, learns, and changes phase."""

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from minitouch_bench.agents.config import PhaseConfig, TrainingConfig
from minitouch_bench.agents.curiosity import CURIOSITIES, Curiosity
from minitouch_bench.agents.keypoints import KeypointModel
from minitouch_bench.agents.replay import Batch, Replay
from minitouch_bench.agents.sac import Sac
from minitouch_bench.machine import processor_flags
from minitouch_bench.policies.networks import (
    ARCHITECTURES,
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


@dataclass(frozen=True)
class TouchScale:
    """Touch as networks see it: (touch - center) / half, both float32 (11,)."""

    center: Tensor
    half: Tensor

    @classmethod
    def of(cls, workspace: Workspace) -> "TouchScale":
        """Map the workspace and the openings to -1 ... 1 and FORCE_SCALE to 1."""
        center, half = torch.zeros(TOUCH_SIZE), torch.ones(TOUCH_SIZE)
        low, high = torch.tensor(workspace.low), torch.tensor(workspace.high)
        center[POSITION], half[POSITION] = (low + high) / 2, (high - low) / 2
        center[OPENINGS], half[OPENINGS] = 0.5, 0.5
        half[FORCES] = FORCE_SCALE
        return cls(center, half)

    def to(self, device: torch.device) -> "TouchScale":
        """Return the same scale on a device."""
        return TouchScale(self.center.to(device), self.half.to(device))

    def scaled(self, touch: Tensor) -> Tensor:
        """Return touch float32 (N, 11) as the networks see it."""
        return (touch - self.center) / self.half

    @torch.no_grad()
    def fold_into(self, actor: TouchActor) -> TouchActor:
        """Return a copy of the actor that takes touch as the environment gives it."""
        folded = copy.deepcopy(actor)
        weight, bias = (
            folded.trunk[0].get_parameter("weight"),
            folded.trunk[0].get_parameter("bias"),
        )
        weight[:, -TOUCH_SIZE:] /= self.half
        bias.sub_(weight[:, -TOUCH_SIZE:] @ self.center)
        return folded


class Learner:
    """The networks of one training and their sources of chance."""

    def __init__(self, config: TrainingConfig, spec: TaskSpec, device: torch.device) -> None:
        self.config = config
        self.device = device
        half = has_bfloat16(device)
        sac = replace(config.sac, bfloat16=config.sac.bfloat16 and half)
        curiosity = replace(config.curiosity, bfloat16=config.curiosity.bfloat16 and half)
        with _weights_drawn_from(config.seed):
            self.keypoints = KeypointModel() if config.sac.keypoint_steps else None
            self.exploring = config.exploration_steps > 0
            self.sac = Sac(
                sac, action_size=spec.action_size, sees_keypoints=self.policy_sees_keypoints
            )
            self.curiosity: Curiosity | None = None
            if config.method != "sac":
                self.curiosity = CURIOSITIES[config.method](curiosity, spec.action_size)
        _arrange(self.sac, device)
        if self.keypoints is not None:
            _arrange(self.keypoints, device)
            self.keypoints.begin()
        self.learns_keypoints = self.keypoints is not None
        if self.curiosity is not None:
            _arrange(self.curiosity, device)
            self.curiosity.begin()
        self.scale = TouchScale.of(spec.workspace).to(device)
        self._begin_phase()
        self.noise = torch.Generator(device).manual_seed(config.seed)
        self.rng = np.random.default_rng(config.seed)

    @property
    def phase(self) -> PhaseConfig:
        """Return the settings of the phase under way."""
        return self.config.exploration if self.exploring else self.config.task_phase

    @property
    def policy_sees_keypoints(self) -> bool:
        """Tell whether the policy under way sees keypoints; while exploring it sees the image."""
        return self.keypoints is not None and not self.exploring

    def begin_task_phase(self, replay: Replay) -> None:
        """Go on from the exploration's networks, on the task's reward.

        With ``critic_updates`` the critics are new, and are fitted to the memory first. With
        keypoints the actor is new as well, and is fitted to the exploration policy.
        """
        self.exploring = False
        self._begin_phase()
        for _ in range(self.phase.critic_updates):
            self.update(replay, 0, critics_only=True)

    def _begin_phase(self) -> None:
        """Make what the phase's networks lack, and their optimizers."""
        after_exploration = not self.exploring and self.config.exploration_steps > 0
        if after_exploration and (self.phase.critic_updates or self.keypoints is not None):
            # Not seed + 1: the training with that seed starts from those weights.
            (seed,) = np.random.SeedSequence(self.config.seed).generate_state(1, np.uint64).tolist()
            with _weights_drawn_from(seed):
                explored = self.sac
                if self.keypoints is not None:
                    self.sac = Sac(
                        explored.config, action_size=explored.action_size, sees_keypoints=True
                    )
                self.sac.keep_prior(explored)
            _arrange(self.sac, self.device)
        self.sac.begin_phase(self.phase)

    def act(self, observation: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Return a stochastic action, float32 (A,)."""
        image = torch.from_numpy(observation["image"])[None].to(self.device)
        touch = torch.from_numpy(observation["touch"])[None].to(self.device)
        if self.keypoints is not None and self.policy_sees_keypoints:
            image = self.keypoints.encode(image)
        sensed = self._sensed(image, self.scale.scaled(touch))
        action = self.sac.act(*sensed, self.noise)[0]
        array: NDArray[np.float32] = action.cpu().numpy()
        return array

    def act_at_random(self) -> NDArray[np.float32]:
        """Return a uniformly random action, float32 (A,)."""
        return self.rng.uniform(-1.0, 1.0, self.sac.action_size).astype(np.float32)

    def update(self, replay: Replay, step: int, *, critics_only: bool = False) -> dict[str, Tensor]:
        """Draw a batch, and do one gradient step on the phase's reward.

        While exploring, the reward is the curiosity's, and the end of an episode is not terminal:
        a terminal end would remove all later reward and so punish success.

        Args:
            replay: Memory to draw from.
            step: Control steps of the phase so far.
            critics_only: Leave actor and temperature as they are; in the task phase alone.

        Returns:
            The losses and other curves of the step, as scalars.
        """
        batch, losses = self._batch(replay), dict[str, Tensor]()
        if self.exploring and self.curiosity is not None:
            errors = self.curiosity.update(batch)
            reward = self.phase.reward_scale * self.curiosity.reward(errors.surprise)
            losses = {"curiosity_loss": errors.loss, "intrinsic_reward": reward.mean()}
        else:
            reward = self.phase.reward_scale * batch.task_reward
            batch = replace(batch, discount=batch.discount * ~batch.ended)
        if self.keypoints is not None and self.learns_keypoints:
            self.keypoints.update(batch.image[::2])
            if self.policy_sees_keypoints:
                now, then = map(self.keypoints.encode, (batch.image, batch.next_image))
                batch = replace(batch, features=now, next_features=then)
        return losses | self.sac.update(
            self._sensed_batch(batch), reward, self.noise, step, critics_only=critics_only
        )

    def _sensed_batch(self, batch: Batch) -> Batch:
        """Return the batch as actor and critics see it."""
        image, touch = self._sensed(batch.image, batch.touch)
        next_image, next_touch = self._sensed(batch.next_image, batch.next_touch)
        features, _ = self._sensed(batch.features, touch)
        next_features, _ = self._sensed(batch.next_features, next_touch)
        return replace(
            batch, image=image, touch=touch, next_image=next_image, next_touch=next_touch,
            features=features, next_features=next_features,
        )  # fmt: skip

    def _sensed(self, image: Tensor, touch: Tensor) -> tuple[Tensor, Tensor]:
        """Return images, or features, and scaled touch with the senses that are left out at 0."""
        for sense in self.config.without:
            if sense == "vision":
                image = torch.zeros_like(image)
            else:
                touch = touch.clone()
                touch[:, SENSED_TOUCH[sense]] = 0.0
        return image, touch

    def _batch(self, replay: Replay) -> Batch:
        keypoints = self.keypoints
        if keypoints is not None and self.policy_sees_keypoints and not self.learns_keypoints:
            replay.encode(lambda image: keypoints.encode(image.to(self.device)))
        batch = replay.sample(
            self.rng,
            self.config.sac.batch_size,
            n_step=1 if self.exploring else self.phase.n_step,
            discount=self.config.sac.discount,
            success_share=self.phase.success_share,
            device=self.device,
        )
        return replace(
            batch,
            touch=self.scale.scaled(batch.touch),
            next_touch=self.scale.scaled(batch.next_touch),
        )

    def actor(self) -> TouchActor:
        """Return the policy as it stands, on the CPU, scales folded in, weights in half precision.

        So a checkpoint of two bytes per weight is the policy that was evaluated. It ignores the
        senses that it learned without by its weights.
        """
        architecture, encoder = TouchActor.architecture, self.sac.encoder
        if self.keypoints is not None and self.policy_sees_keypoints:
            architecture, encoder = KeypointActor.architecture, self.keypoints.encoder
        learned = {f"encoder.{name}": value for name, value in encoder.state_dict().items()}
        actor = ARCHITECTURES[architecture](self.sac.action_size, self.config.sac.encoder_width)
        actor.load_state_dict(learned | self.sac.actor.state_dict())
        self._fold_constants(actor)
        return self.scale.to(torch.device("cpu")).fold_into(actor).half().float()

    @torch.no_grad()
    def _fold_constants(self, actor: TouchActor) -> None:
        """Move what a constant sense adds to the first layer into its bias."""
        weight, bias = (actor.trunk[0].get_parameter(name) for name in ("weight", "bias"))
        for sense in self.config.without:
            if sense == "vision":
                if not self.policy_sees_keypoints:  # whose coordinates would be 0
                    black = torch.zeros(1, *IMAGE_SHAPE, dtype=torch.uint8)
                    bias.add_(weight[:, :-TOUCH_SIZE] @ actor.encoder(black)[0])
                weight[:, :-TOUCH_SIZE] = 0.0
            else:
                weight[:, -TOUCH_SIZE:][:, SENSED_TOUCH[sense]] = 0.0

    def state(self) -> dict[str, Any]:
        """Return everything that later steps depend on."""
        state = {
            "exploring": self.exploring,
            "learns_keypoints": self.learns_keypoints,
            "sac": self.sac.state_dict(),
            "optimizers": {n: o.state_dict() for n, o in self.sac.optimizers().items()},
            "noise": self.noise.get_state(),
            "rng": self.rng.bit_generator.state,
        }
        if self.curiosity is not None:
            state |= self.curiosity.state()
        if self.keypoints is not None:
            state |= self.keypoints.state()
        return state

    def load_state(self, state: dict[str, Any]) -> None:
        """Go on from what ``state`` returned."""
        self.exploring = state["exploring"]
        self.learns_keypoints = state["learns_keypoints"]
        self._begin_phase()
        self.sac.load_state_dict(state["sac"])
        for name, optimizer in self.sac.optimizers().items():
            optimizer.load_state_dict(state["optimizers"][name])
        self.noise.set_state(state["noise"].cpu())
        self.rng.bit_generator.state = state["rng"]
        if self.curiosity is not None:
            self.curiosity.load_state(state)
        if self.keypoints is not None:
            self.keypoints.load_state(state)
