"""Train SAC for 2,000 steps, evaluate it in memory every 500, and plot the touch share."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from stable_baselines3 import SAC

import minitouch_bench as mt

if __name__ == "__main__":
    env = mt.make("pushing")
    small = {"net_arch": [64], "features_extractor_kwargs": {"cnn_output_dim": 64}}
    model = SAC("MultiInputPolicy", env, buffer_size=5000, train_freq=8, policy_kwargs=small)
    curve = []
    for steps in (500, 1000, 1500, 2000):
        model.learn(500, reset_num_timesteps=False)
        run = mt.evaluate(model, "smoke", tasks=["pushing"], episodes=3)
        curve.append(run["pushing"].touch_share)
        print(f"{steps} steps: touch share {curve[-1].value:.3f}")
    steps = [500, 1000, 1500, 2000]
    plt.plot(steps, [one.value for one in curve], marker="o")
    plt.fill_between(steps, [one.low for one in curve], [one.high for one in curve], alpha=0.3)
    plt.xlabel("control steps")
    plt.ylabel("touch share, 95 % interval")
    plt.savefig("curve.png")
