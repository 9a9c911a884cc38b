import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv

import minitouch_bench as mt

if __name__ == "__main__":
    torch.set_num_threads(1)  # more wait for busy cores
    env = make_vec_env(lambda: mt.make("pushing"), n_envs=2, vec_env_cls=SubprocVecEnv)
    model = PPO("MultiInputPolicy", env, n_steps=100, batch_size=50, n_epochs=2)
    model.learn(400)
    model.save("pushing-ppo.zip")
    env.close()
