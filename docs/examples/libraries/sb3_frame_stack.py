import gymnasium
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack

env = DummyVecEnv([lambda: gymnasium.make("minitouch_bench:MiniTouch/Pushing-v1")])
stacked = VecFrameStack(env, n_stack=4)
model = SAC("MultiInputPolicy", stacked, buffer_size=10_000, learning_starts=100, batch_size=32)
model.learn(200)
model.save("pushing-stacked.zip")
