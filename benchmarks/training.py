"""What training costs on one core: a gradient step of each method, a control step by part."""

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from minitouch_bench.agents import METHODS, training
from minitouch_bench.agents.config import PRESETS, TrainingConfig
from minitouch_bench.agents.learner import Learner, kept_size
from minitouch_bench.agents.memory import CheckpointFiles, ReplayMemory
from minitouch_bench.agents.training_directory import run_training
from minitouch_bench.policies.networks import TOUCH_SIZE
from minitouch_bench.processes import keep_freed_memory
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.tasks.environment import MiniTouchEnv

FILLED, UPDATES, ACTIONS = 1024, 20, 50
RANDOM_STEPS, STEPS = 1000, 2000

PARTS = {
    "simulator": ((MiniTouchEnv, "step"), (MiniTouchEnv, "reset")),
    "acting": ((Learner, "act"),),
    "drawing a batch": ((ReplayMemory, "sample"),),
    "learning": ((Learner, "update"),),
    "writing": (
        (ReplayMemory, "add"),
        (CheckpointFiles, "save"),
        (training.Training, "_write_rows"),
    ),
}
"""The functions whose time makes each part; time in a function of another part is that part's."""


def main() -> None:
    """Print the costs, for the preset named, or for default."""
    keep_freed_memory()
    torch.set_num_threads(1)
    preset = sys.argv[1] if len(sys.argv) > 1 else "default"
    for task in TASK_NAMES:
        environment, memory, rate = fill(task)
        columns = [part for part in memory.state().values() if isinstance(part, torch.Tensor)]
        size = len(memory.images_since(0)) + sum(column.nbytes for column in columns)
        memory = size / memory.rows
        print(f"{task}: {rate:.0f} control steps/s, {memory:.0f} bytes a transition")
    observation, _ = environment.reset(seed=0)
    for method in METHODS:
        config = replace(with_short_switch(PRESETS[preset](TASK_NAMES[-1])), method=method)
        learner = Learner(config, environment.task.spec, torch.device("cpu"))
        if method == "sac":  # the task phase of the others costs the same
            learner.begin_task_phase(memory)
        act = cpu_ms(ACTIONS, lambda learner=learner: learner.act(observation))
        update = cpu_ms(UPDATES, lambda learner=learner: learner.update(memory, 0))
        print(f"{method}: {act:.1f} ms an action, {update:.1f} ms a gradient step")
    for method in METHODS:
        parts = control_step_ms(preset, method)
        listed = ", ".join(f"{name} {part:.1f}" for name, part in parts.items())
        print(f"{method}: {sum(parts.values()):.1f} ms a control step: {listed}")


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


def control_step_ms(preset: str, method: str) -> dict[str, float]:
    """Return the processor's milliseconds by part of a control step, once learning has begun.

    It is one of the exploration, with ``sac`` of the task phase.
    """
    config = with_short_switch(PRESETS[preset]("pushing"))
    config = replace(
        config,
        method=method,
        random_steps=RANDOM_STEPS,
        exploration=replace(config.exploration, steps=RANDOM_STEPS + STEPS),
        task_phase=replace(config.task_phase, steps=0),
        evaluate_every=0,
    )
    clock = PartClock()
    with TemporaryDirectory() as folder, clock:
        run_training(config, Path(folder) / "training", device="cpu")
    return {name: 1000 * spent / STEPS for name, spent in clock.spent.items()}


class PartClock:
    """Counts the processor's seconds of each part, from the first gradient step on."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = defaultdict(float)
        self._parts = ["loop"]
        self._last = time.process_time()
        self._originals = [
            (owner, name, getattr(owner, name)) for part in PARTS.values() for owner, name in part
        ]

    def __enter__(self) -> "PartClock":
        for part, functions in PARTS.items():
            for owner, name in functions:
                setattr(owner, name, self._timed(part, getattr(owner, name)))
        return self

    def __exit__(self, *_: object) -> None:
        for owner, name, original in self._originals:
            setattr(owner, name, original)

    def _switch(self) -> None:
        now = time.process_time()
        if "learning" in self.spent or "learning" in self._parts:
            self.spent[self._parts[-1]] += now - self._last
        self._last = now

    def _timed(self, part: str, function: Callable[..., object]) -> Callable[..., object]:
        @wraps(function)
        def timed(*args: object, **options: object) -> object:
            self._switch()
            self._parts.append(part)
            try:
                return function(*args, **options)
            finally:
                self._switch()
                self._parts.pop()

        return timed


if __name__ == "__main__":
    main()
