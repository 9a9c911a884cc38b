import gymnasium
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack

torch.set_num_threads(1)  # more wait for busy cores
env = DummyVecEnv([lambda: gymnasium.make("minitouch_bench:MiniTouch/Pushing-v1")])
stacked = VecFrameStack(env, n_stack=4)
model = SAC("MultiInputPolicy", stacked, buffer_size=10_000, learning_starts=100, batch_size=32)
model.learn(200)
model.save("pushing-stacked.zip")
