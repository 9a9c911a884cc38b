"""RND on a task of which the answer is known: a square that starts in the corner of a plane."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from minitouch_bench.agents.config import TrainingConfig
from minitouch_bench.agents.learner import Learner
from minitouch_bench.agents.memory import ReplayMemory
from minitouch_bench.protocol.minitouch import PROTOCOL

STEPS, RANDOM_STEPS, EPISODE, STRIDE = 3000, 500, 50, 0.04
TOUCH = np.zeros(11, np.float32)


def picture(place):
    image = np.zeros((1, 84, 84), np.uint8)
    x, y = (72 * place).astype(int)
    image[0, y : y + 12, x : x + 12] = 255
    return image


def cells_seen(method, seed):
    """Return the share of the plane that 3,000 control steps visit; at random without a method."""
    spec = PROTOCOL.task("playing")
    config = TrainingConfig("playing", method=method or "rnd", seed=seed)
    config = replace(
        config,
        sac=replace(config.sac, shift=0, bfloat16=False),
        curiosity=replace(config.curiosity, bfloat16=False),
    )
    learner = Learner(config, spec, torch.device("cpu"))
    memory = ReplayMemory(STEPS * 2, 11, spec.action_size)
    seen = np.zeros((10, 10), bool)
    for step in range(STEPS):
        if step % EPISODE == 0:
            place = np.full(2, 0.05)
            memory.begin_episode(picture(place), TOUCH)
        if method and step >= RANDOM_STEPS:
            action = learner.act({"image": picture(place), "touch": TOUCH})
        else:
            action = learner.act_at_random()
        place = np.clip(place + STRIDE * action[:2], 0.0, 1.0)
        seen[tuple((9.99 * place).astype(int))] = True
        memory.add(action, 0.0, picture(place), TOUCH, success=False, ended=False)
        if method and step >= RANDOM_STEPS and step % 2:
            learner.update(memory, step)
    return seen.mean()


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("method", ["rnd", "rnd-touch"])
def test_it_sees_more_of_the_plane_than_chance(method):
    torch.set_num_threads(1)
    chance, curious = ([cells_seen(one, seed) for seed in range(2)] for one in (None, method))
    print(method, curious, "chance", chance)
    assert min(curious) > 2 * max(chance)
