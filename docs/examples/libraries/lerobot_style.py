import gymnasium
import numpy as np
from gymnasium import spaces


class LeRobotStyle(gymnasium.ObservationWrapper):
    def __init__(self, env):
        super().__init__(env)
        self.observation_space = spaces.Dict(
            pixels=spaces.Box(0, 255, (84, 84, 3), np.uint8),
            agent_pos=env.observation_space["touch"],
        )

    def observation(self, observation):
        return {
            "pixels": np.repeat(observation["image"][0][:, :, None], 3, axis=2),
            "agent_pos": observation["touch"],
        }


env = LeRobotStyle(gymnasium.make("minitouch_bench:MiniTouch/Pushing-v1"))
observation, info = env.reset(seed=0)
assert observation in env.observation_space
for _ in range(300):
    *_, terminated, truncated, info = env.step(env.action_space.sample())
    if terminated or truncated:
        print("success:", bool(info["is_success"]))
        env.reset()
