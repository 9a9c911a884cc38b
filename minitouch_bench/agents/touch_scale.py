"""What the networks see of the touch vector: each number about 1 in size."""

import copy
from dataclasses import dataclass

import torch
from torch import Tensor

from minitouch_bench.policies.networks import TOUCH_SIZE, TouchActor
from minitouch_bench.protocol.spec import Workspace
from minitouch_bench.sensing.observation import FORCES, OPENINGS, POSITION


@dataclass(frozen=True)
class TouchScale:
    """Touch as networks see it: (touch - center) / half, both float32 (11,)."""

    center: Tensor
    half: Tensor

    @classmethod
    def of(cls, workspace: Workspace, force_scale: float) -> "TouchScale":
        """Map the workspace and the openings to -1 ... 1 and ``force_scale`` (N) to 1."""
        center, half = torch.zeros(TOUCH_SIZE), torch.ones(TOUCH_SIZE)
        low, high = torch.tensor(workspace.low), torch.tensor(workspace.high)
        center[POSITION], half[POSITION] = (low + high) / 2, (high - low) / 2
        center[OPENINGS], half[OPENINGS] = 0.5, 0.5
        half[FORCES] = force_scale
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
