"""Draw the keypoints that a final policy sees: python keypoints.py FINAL.safetensors TASK"""

import sys

import matplotlib.pyplot as plt
import torch
from safetensors.torch import load_file

import minitouch_bench as mt
from minitouch_bench.policies.networks import KEYPOINT_SCALE, KEYPOINT_STRIDE, KeypointEncoder

policy, task = sys.argv[1:]
weights = {name: value.float() for name, value in load_file(policy).items()}
if "encoder.windows.weight" not in weights:
    sys.exit(f"{policy} sees no keypoints: give the final.safetensors of a training")
encoder = KeypointEncoder()
encoder.load_state_dict({name: weights[f"encoder.{name}"] for name in encoder.state_dict()})
environment = mt.make(task)
environment.action_space.seed(0)
figure, plots = plt.subplots(1, 4, figsize=(8, 2.1), layout="constrained")
for seed, plot in enumerate(plots):
    observation, _ = environment.reset(seed=seed)
    for _ in range(6):  # so that the hand is somewhere else each time
        observation, *_ = environment.step(environment.action_space.sample())
    image = torch.from_numpy(observation["image"])[None]
    with torch.no_grad():
        coordinates = encoder(image)[0]
    middle, reach = (image.shape[-1] - 1) / 2, 9.5 * KEYPOINT_STRIDE  # of the 20 places in a row
    rows, columns = (middle + coordinates / KEYPOINT_SCALE * reach).chunk(2)
    plot.imshow(image[0, 0], cmap="gray", vmin=0, vmax=255)
    plot.scatter(columns, rows, s=12, facecolors="none", edgecolors="orange")
    plot.axis("off")
figure.savefig("keypoints.png", dpi=120)
