import torch

from minitouch_bench.agents.learner import TouchScale
from minitouch_bench.policies.networks import TouchActor
from minitouch_bench.protocol.spec import Workspace

WORKSPACE = Workspace((0.25, -0.2, 0.0), (0.7, 0.25, 0.04))


def test_the_workspace_spans_minus_one_to_one():
    scale = TouchScale.of(WORKSPACE)
    corners = torch.tensor([[*WORKSPACE.low, 0, 0, *[-10] * 6], [*WORKSPACE.high, 1, 1, *[10] * 6]])
    expected = torch.tensor([[-1.0] * 11, [1.0] * 11])
    torch.testing.assert_close(scale.scaled(corners), expected)


def test_a_folded_actor_acts_the_same_on_raw_touch():
    torch.manual_seed(0)
    scale, actor = TouchScale.of(WORKSPACE), TouchActor(4)
    image = torch.randint(0, 256, (5, 1, 84, 84), dtype=torch.uint8)
    touch = torch.randn(5, 11) * scale.half + scale.center
    expected = actor(image, scale.scaled(touch))
    scale.fold_into(actor)
    torch.testing.assert_close(actor(image, touch), expected)
