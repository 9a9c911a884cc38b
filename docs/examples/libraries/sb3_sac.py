import gymnasium
from stable_baselines3 import SAC

env = gymnasium.make("minitouch_bench:MiniTouch/Pushing-v1")
model = SAC("MultiInputPolicy", env, buffer_size=10_000, learning_starts=100, batch_size=32)
model.learn(200)
model.save("pushing.zip")
