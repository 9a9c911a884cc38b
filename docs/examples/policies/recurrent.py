import torch
from torch import Tensor, nn

import minitouch_bench as mt


class Recurrent(nn.Module):
    """A GRU over a coarse image and the touch vector."""

    def __init__(self) -> None:
        super().__init__()
        self.coarse = nn.Sequential(nn.AvgPool2d(12), nn.Flatten())  # 7 x 7
        self.cell, self.head = nn.GRUCell(49 + 11, 64), nn.Linear(64, 5)
        self.register_buffer("state", torch.zeros(1, 64))

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        seen = torch.cat((self.coarse(image.float() / 255), touch), 1)
        self.state[:] = self.cell(seen, self.state)
        return torch.tanh(self.head(self.state))


policy = Recurrent().eval()  # load your weights, then set policy.state to zero
print(mt.export(policy, "recurrent.pt2", task="pushing"))
torch.jit.script(policy).save("recurrent.pt")  # the same policy, deprecated
