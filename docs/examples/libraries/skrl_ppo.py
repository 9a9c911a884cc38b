import gymnasium
import torch
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from skrl.utils.spaces.torch import unflatten_tensorized_space
from torch import nn


class Network(Model):
    """Image and touch in, ``size`` numbers out."""

    def build(self, size):
        self.vision = nn.Sequential(
            nn.Conv2d(1, 16, 8, 4), nn.ReLU(), nn.Conv2d(16, 32, 4, 2), nn.ReLU(), nn.Flatten()
        )
        self.head = nn.Linear(2592 + 11, size)

    def run(self, inputs):
        seen = unflatten_tensorized_space(self.observation_space, inputs["observations"])
        visual = self.vision(seen["image"].float() / 255.0)
        return self.head(torch.cat([visual, seen["touch"]], 1))


class Policy(GaussianMixin, Network):
    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self, clip_actions=True)
        self.build(self.num_actions)
        self.log_std = nn.Parameter(torch.zeros(self.num_actions))

    def compute(self, inputs, role):
        return self.run(inputs), {"log_std": self.log_std}


class Value(DeterministicMixin, Network):
    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.build(1)

    def compute(self, inputs, role):
        return self.run(inputs), {}


torch.set_num_threads(1)  # more wait for busy cores
# One environment: of several, skrl would also learn from the steps that only reset one of them.
env = wrap_env(gymnasium.make("minitouch_bench:MiniTouch/Pushing-v1"))
spaces = {
    "observation_space": env.observation_space,
    "action_space": env.action_space,
    "device": env.device,
}
agent = PPO(
    models={"policy": Policy(**spaces), "value": Value(**spaces)},
    memory=RandomMemory(memory_size=50, num_envs=env.num_envs, device=env.device),
    cfg=PPO_CFG(rollouts=50, learning_epochs=2, mini_batches=2, time_limit_bootstrap=True),
    **spaces,
)
SequentialTrainer(env=env, agents=agent, cfg={"timesteps": 150}).train()
agent.save("pushing-skrl.pt")
