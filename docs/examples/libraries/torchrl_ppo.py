import torch
from tensordict.nn import InteractionType, TensorDictModule, TensorDictSequential
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymEnv, ParallelEnv
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE


def make():
    return GymEnv("minitouch_bench:MiniTouch/Pushing-v1").auto_register_info_dict()


class Features(nn.Module):
    def __init__(self):
        super().__init__()
        self.vision = nn.Sequential(nn.Conv2d(1, 16, 8, 4), nn.ReLU(), nn.Conv2d(16, 32, 4, 2))

    def forward(self, image, touch):
        lead = image.shape[:-3]
        visual = self.vision(image.reshape(-1, 1, 84, 84).float() / 255.0).relu()
        return torch.cat([visual.reshape(*lead, -1), touch], -1)


if __name__ == "__main__":
    torch.set_num_threads(1)  # more wait for busy cores
    env = ParallelEnv(2, make)
    head = nn.Sequential(
        nn.Linear(2592 + 11, 2 * env.action_spec.shape[-1]), NormalParamExtractor()
    )
    network = TensorDictSequential(
        TensorDictModule(Features(), ["image", "touch"], ["features"]),
        TensorDictModule(head, ["features"], ["loc", "scale"]),
    )
    actor = ProbabilisticActor(
        network,
        in_keys=["loc", "scale"],
        spec=env.action_spec,
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -1.0, "high": 1.0},
        return_log_prob=True,
        default_interaction_type=InteractionType.RANDOM,
    )
    critic = TensorDictSequential(
        TensorDictModule(Features(), ["image", "touch"], ["value_features"]),
        ValueOperator(nn.Linear(2592 + 11, 1), in_keys=["value_features"]),
    )
    loss_module = ClipPPOLoss(actor, critic)
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    optimizer = torch.optim.Adam(loss_module.parameters(), lr=3e-4)
    for data in Collector(env, actor, frames_per_batch=200, total_frames=400):
        with torch.no_grad():
            advantage(data)
        for part in torch.randperm(200).split(50):
            losses = loss_module(data.reshape(-1)[part])
            loss = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        print(f"{int(data['next', 'is_success'].sum())} successes, loss {loss.item():.3f}")
