"""What training costs on one core: control steps with random actions, and a gradient step."""

import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from minitouch_bench.agents import METHODS
from minitouch_bench.agents.config import PRESETS, TrainingConfig
from minitouch_bench.agents.learner import Learner, kept_size
from minitouch_bench.agents.memory import ReplayMemory
from minitouch_bench.policies.networks import TOUCH_SIZE
from minitouch_bench.processes import keep_freed_memory
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.tasks.environment import MiniTouchEnv

FILLED, UPDATES, ACTIONS = 1024, 20, 50


def main() -> None:
    """Print the costs, for the preset named, or for default."""
    keep_freed_memory()
    torch.set_num_threads(1)
    preset = sys.argv[1] if len(sys.argv) > 1 else "default"
    for task in TASK_NAMES:
        environment, memory, rate = fill(task)
        columns = [part for part in memory.state().values() if isinstance(part, torch.Tensor)]
        size = len(memory.images_since(0)) + sum(column.nbytes for column in columns)
        print(f"{task}: {rate:.0f} control steps/s, {size / memory.rows:.0f} bytes a transition")
    observation, _ = environment.reset(seed=0)
    for method in METHODS:
        config = replace(with_short_switch(PRESETS[preset](TASK_NAMES[-1])), method=method)
        learner = Learner(config, environment.task.spec, torch.device("cpu"))
        if method == "sac":  # the task phase of the others costs the same
            learner.begin_task_phase(memory)
        act = cpu_ms(ACTIONS, lambda learner=learner: learner.act(observation))
        update = cpu_ms(UPDATES, lambda learner=learner: learner.update(memory, 0))
        print(f"{method}: {act:.1f} ms an action, {update:.1f} ms a gradient step")


def with_short_switch(config: TrainingConfig) -> TrainingConfig:
    """Return settings whose task phase begins at once."""
    phase = config.task_phase
    keypoint_updates = min(1, phase.keypoint_updates)
    short = replace(phase, keypoint_updates=keypoint_updates, fitting_updates=0)
    return replace(config, task_phase=short)


def cpu_ms(count: int, work: Callable[[], object]) -> float:
    """Return the median of the processor's milliseconds per call."""
    work()
    measured = []
    for _ in range(count):
        started = time.process_time()
        work()
        measured.append(1000 * (time.process_time() - started))
    return float(np.median(measured))


def fill(task: str) -> tuple[MiniTouchEnv, ReplayMemory, float]:
    """Return an environment, the replay memory of random actions, and steps per second."""
    environment = MiniTouchEnv(task)
    size = environment.action_space.shape[0]
    memory = ReplayMemory(FILLED, TOUCH_SIZE, size, kept_size(size))
    rng = np.random.default_rng(0)
    started, ended = time.process_time(), True
    for _ in range(FILLED):
        if ended:
            observation, _ = environment.reset(seed=int(rng.integers(2**31)))
            memory.begin_episode(observation["image"], observation["touch"])
        action = rng.uniform(-1, 1, size).astype(np.float32)
        observation, reward, terminated, truncated, info = environment.step(action)
        memory.add(
            action, reward, observation["image"], observation["touch"],
            success=bool(info["is_success"]), ended=terminated,
        )  # fmt: skip
        ended = terminated or truncated
    return environment, memory, FILLED / (time.process_time() - started)


if __name__ == "__main__":
    main()
