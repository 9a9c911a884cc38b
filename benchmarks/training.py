"""What training costs on one core: a control step, an action, a gradient step, and memory."""

import sys
import time
from dataclasses import replace

import numpy as np
import torch

from minitouch_bench.agents import METHODS
from minitouch_bench.agents.config import PRESETS
from minitouch_bench.agents.learner import Learner
from minitouch_bench.agents.replay import Replay
from minitouch_bench.policies.networks import TOUCH_SIZE
from minitouch_bench.processes import keep_freed_memory
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.tasks.environment import MiniTouchEnv

STEPS, UPDATES, ACTIONS = 1024, 12, 50


def cpu_ms(count, work):
    """Return the processor's milliseconds per call, which other processes do not lengthen."""
    work()
    started = time.process_time()
    for _ in range(count):
        work()
    return 1000 * (time.process_time() - started) / count


def fill(task):
    """Return an environment, the replay memory of random actions, and steps per second."""
    environment = MiniTouchEnv(task)
    size = environment.action_space.shape[0]
    replay = Replay(STEPS, TOUCH_SIZE, size, compress=True)
    rng = np.random.default_rng(0)
    started, ended = time.process_time(), True
    for _ in range(STEPS):
        if ended:
            observation, _ = environment.reset(seed=int(rng.integers(2**31)))
            replay.begin_episode(observation["image"], observation["touch"])
        action = rng.uniform(-1, 1, size).astype(np.float32)
        observation, reward, terminated, truncated, info = environment.step(action)
        replay.add(
            action, reward, observation["image"], observation["touch"],
            success=bool(info["is_success"]), ended=terminated,
        )  # fmt: skip
        ended = terminated or truncated
    return environment, replay, STEPS / (time.process_time() - started), observation


def main():
    """Print the figures of every task and method, for the preset named, or for default."""
    keep_freed_memory()
    torch.set_num_threads(1)
    preset = PRESETS[sys.argv[1] if len(sys.argv) > 1 else "default"]
    for task in TASK_NAMES:
        environment, replay, rate, observation = fill(task)
        memory = replay.nbytes / replay.rows
        print(f"{task}: {rate:.0f} control steps/s, {memory:.0f} bytes a transition")
    for method in METHODS:
        config = replace(preset(TASK_NAMES[-1]), method=method)
        learner = Learner(config, environment.task.spec, torch.device("cpu"))
        act = cpu_ms(ACTIONS, lambda one=learner: one.act(observation))
        update = cpu_ms(UPDATES, lambda one=learner: one.update(replay, 0))
        print(f"{method}: {act:.1f} ms an action, {update:.0f} ms a gradient step")


if __name__ == "__main__":
    main()
