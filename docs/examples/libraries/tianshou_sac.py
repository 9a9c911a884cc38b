import gymnasium
import torch
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import SubprocVectorEnv
from tianshou.policy import SACPolicy
from torch import nn


class Features(nn.Module):
    def __init__(self):
        super().__init__()
        self.vision = nn.Sequential(
            nn.Conv2d(1, 16, 8, 4), nn.ReLU(), nn.Conv2d(16, 32, 4, 2), nn.ReLU(), nn.Flatten()
        )

    def forward(self, observation):
        image = torch.as_tensor(observation.image).float() / 255.0
        return torch.cat([self.vision(image), torch.as_tensor(observation.touch)], 1)


class Actor(nn.Module):
    def __init__(self, actions):
        super().__init__()
        self.features, self.head = Features(), nn.Linear(2592 + 11, 2 * actions)

    def forward(self, observation, state=None, info=None):
        mean, log_std = self.head(self.features(observation)).chunk(2, 1)
        return (mean, log_std.clamp(-5, 2).exp()), state


class Critic(nn.Module):
    def __init__(self, actions):
        super().__init__()
        self.features, self.head = Features(), nn.Linear(2592 + 11 + actions, 1)

    def forward(self, observation, action):
        return self.head(torch.cat([self.features(observation), torch.as_tensor(action)], 1))


def make():
    return gymnasium.make("minitouch_bench:MiniTouch/Pushing-v1")


if __name__ == "__main__":
    torch.set_num_threads(1)  # more wait for busy cores
    envs = SubprocVectorEnv([make, make])
    space = envs.action_space[0]
    networks = Actor(space.shape[0]), Critic(space.shape[0]), Critic(space.shape[0])
    pairs = [(network, torch.optim.Adam(network.parameters(), lr=3e-4)) for network in networks]
    policy = SACPolicy(*pairs[0], *pairs[1], *pairs[2], action_space=space)
    collector = Collector(policy, envs, VectorReplayBuffer(10_000, 2))
    collector.collect(n_step=100, random=True)
    for _ in range(10):
        collector.collect(n_step=20)
        losses = policy.update(32, collector.buffer)
    print({name: round(value, 3) for name, value in losses.items()})
    envs.close()
