"""Choose the action sequences of the policy ``open-loop``, on seeds that no suite uses.

``python -m benchmarks.open_loop [TASK...]`` records the scripted policy on some seeds, plays each
recording blind on others, and keeps the best per task in ``policies/open_loop.npz``.
"""

import sys

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.python_objects import OPEN_LOOP_FILE
from minitouch_bench.policies.scripted import make_controller
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.tasks.environment import MiniTouchEnv

CANDIDATES, TRIALS, FIRST_SEED = 12, 24, 7_000_000

Actions = NDArray[np.float32]


def record(environment: MiniTouchEnv, seed: int) -> Actions:
    """Return the scripted policy's actions in one episode, float32 (T, A)."""
    environment.reset(seed=seed)
    controller, actions, ended = make_controller(environment), [], False
    while not ended:
        actions.append(controller.act())
        *_, terminated, truncated, _ = environment.step(actions[-1])
        ended = terminated or truncated
    return np.array(actions, np.float32)


def score(environment: MiniTouchEnv, actions: Actions, seeds: range) -> float:
    """Return the share of episodes that a sequence solves blind; without a goal, of touch."""
    total, still = 0.0, np.zeros_like(actions[0])
    for seed in seeds:
        environment.reset(seed=seed)
        touched, steps, ended = 0, 0, False
        while not ended:
            action = actions[steps] if steps < len(actions) else still
            *_, terminated, truncated, info = environment.step(action)
            steps, touched = steps + 1, touched + (info["contact_ticks"] > 0)
            ended = terminated or truncated
        goal = environment.task.spec.has_goal
        total += float(info["success"]) if goal else touched / steps
    return total / len(seeds)


def choose(task: str) -> Actions:
    """Return the best of the recordings."""
    environment = MiniTouchEnv(task)
    trials = range(FIRST_SEED + CANDIDATES, FIRST_SEED + CANDIDATES + TRIALS)
    best, best_score = np.zeros((1, environment.task.spec.action_size), np.float32), -1.0
    for seed in range(FIRST_SEED, FIRST_SEED + CANDIDATES):
        actions = record(environment, seed)
        reached = score(environment, actions, trials)
        print(f"{task}: seed {seed}, {len(actions)} steps, {reached:.3f}", flush=True)
        if reached > best_score:
            best, best_score = actions, reached
    environment.close()
    return best


if __name__ == "__main__":
    kept = dict(np.load(OPEN_LOOP_FILE)) if OPEN_LOOP_FILE.exists() else {}
    kept |= {task: choose(task) for task in sys.argv[1:] or TASK_NAMES}
    np.savez_compressed(OPEN_LOOP_FILE, **kept)
