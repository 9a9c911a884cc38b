import gymnasium
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.torch_layers import CombinedExtractor

torch.set_num_threads(1)  # more wait for busy cores
UNITS = torch.tensor([0.5] * 3 + [1.0] * 2 + [10.0] * 6)  # position (m), openings, forces (N)


class ScaledTouch(CombinedExtractor):
    """Scale touch in the network, which the zip contains, not in a wrapper."""

    def forward(self, observations):
        return super().forward({**observations, "touch": observations["touch"] / UNITS})


env = gymnasium.make("minitouch_bench:MiniTouch/Pushing-v1")
model = SAC(
    "MultiInputPolicy", env, buffer_size=10_000, learning_starts=100, batch_size=32,
    policy_kwargs={"features_extractor_class": ScaledTouch},
)  # fmt: skip
model.learn(200)
model.save("pushing.zip")
