import torch

from minitouch_bench.agents.curiosity import Curiosity, Errors
from minitouch_bench.simulation.observation import FORCES, POSITION

CELLS = 8  # along each axis of the workspace


class TouchCounts(Curiosity):
    """r = 1 / sqrt(n), n: how often a batch had the reached cell, with or without a touch."""

    def __init__(self, config, action_size):
        super().__init__(config)
        # A buffer is in each checkpoint. A network is an attribute: the optimizer finds it.
        self.register_buffer("visits", torch.zeros(2 * CELLS**3))

    def errors(self, batch):
        touch = batch.next_touch  # positions in -1 ... 1, forces in units of 10 N
        x, y, z = ((touch[:, POSITION] + 1) / 2 * CELLS).long().clamp(0, CELLS - 1).T
        touches = (touch[:, FORCES].abs() > 0.2).any(dim=1)  # 2 N: a finger alone weighs 1 N
        cell = ((x * CELLS + y) * CELLS + z) * 2 + touches
        self.visits += torch.bincount(cell, minlength=len(self.visits))
        surprise = self.visits[cell].rsqrt()  # one number per row, not below 0
        return Errors(surprise, surprise.mean())  # the second is the networks' loss
