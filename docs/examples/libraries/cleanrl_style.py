import gymnasium
import torch
from torch import nn
from torch.distributions import Normal

import minitouch_bench as mt

torch.set_num_threads(1)  # more wait for busy cores
ENVS, STEPS, UPDATES, GAMMA, LAMBDA = 2, 100, 2, 0.99, 0.95


class Agent(nn.Module):
    def __init__(self, actions):
        super().__init__()
        self.vision = nn.Sequential(
            nn.Conv2d(1, 16, 8, 4), nn.ReLU(), nn.Conv2d(16, 32, 4, 2), nn.ReLU(), nn.Flatten()
        )
        self.mean = nn.Sequential(nn.Linear(2592 + 11, 128), nn.Tanh(), nn.Linear(128, actions))
        self.value = nn.Sequential(nn.Linear(2592 + 11, 128), nn.Tanh(), nn.Linear(128, 1))
        self.log_std = nn.Parameter(torch.zeros(actions))

    def forward(self, observation):
        visual = self.vision(observation["image"].float() / 255.0)
        features = torch.cat([visual, observation["touch"]], 1)
        return Normal(self.mean(features), self.log_std.exp()), self.value(features)[:, 0]


def to_torch(observation):
    return {name: torch.as_tensor(values) for name, values in observation.items()}


envs = gymnasium.make_vec("minitouch_bench:MiniTouch/Pushing-v1", num_envs=ENVS)
agent = Agent(envs.single_action_space.shape[0])
optimizer = torch.optim.Adam(agent.parameters(), lr=3e-4)
observation, info = envs.reset(seed=0)
ended = torch.zeros(ENVS)
for update in range(UPDATES):
    seen, actions, log_probs, values, rewards, ends, played = [], [], [], [], [], [], []
    successes = 0
    for _ in range(STEPS):
        tensors = to_torch(observation)
        with torch.no_grad():
            distribution, value = agent(tensors)
            action = distribution.sample()
        observation, reward, terminated, truncated, info = envs.step(
            action.clamp(-1.0, 1.0).numpy()
        )
        successes += info["is_success"].sum()
        seen.append(tensors)
        actions.append(action)
        log_probs.append(distribution.log_prob(action).sum(1))
        values.append(value)
        rewards.append(torch.as_tensor(reward, dtype=torch.float32))
        played.append(ended == 0.0)  # the step after an end only resets, whatever the action
        ended = torch.as_tensor(terminated | truncated, dtype=torch.float32)
        ends.append(ended)
    with torch.no_grad():
        values.append(agent(to_torch(observation))[1])
    advantage, advantages = torch.zeros(ENVS), []
    for step in reversed(range(STEPS)):
        goes_on = 1.0 - ends[step]
        delta = rewards[step] + GAMMA * values[step + 1] * goes_on - values[step]
        advantage = delta + GAMMA * LAMBDA * goes_on * advantage
        advantages.insert(0, advantage)
    batch = {name: torch.cat([one[name] for one in seen]) for name in seen[0]}
    action, log_prob, advantage = torch.cat(actions), torch.cat(log_probs), torch.cat(advantages)
    returns = advantage + torch.cat(values[:-1])
    kept = torch.cat(played).nonzero()[:, 0]
    for _ in range(2):
        for part in kept[torch.randperm(len(kept))].split(50):
            distribution, value = agent({name: batch[name][part] for name in batch})
            ratio = (distribution.log_prob(action[part]).sum(1) - log_prob[part]).exp()
            gain = torch.min(
                ratio * advantage[part], ratio.clamp(0.8, 1.2) * advantage[part]
            ).mean()
            loss = 0.5 * (value - returns[part]).square().mean() - gain
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    print(f"update {update}: {successes} successes, loss {loss.item():.3f}")
envs.close()


class Exported(nn.Module):
    """The agent as minitouch-bench calls it: two tensors in, the action of an evaluation out."""

    def __init__(self, agent):
        super().__init__()
        self.agent = agent

    def forward(self, image, touch):
        # Not by Normal: torch.export cannot trace the checks of its arguments.
        visual = self.agent.vision(image.float() / 255.0)
        return self.agent.mean(torch.cat([visual, touch], 1)).clamp(-1.0, 1.0)


print(mt.export(Exported(agent), "pushing.pt2", task="pushing"))
