"""Speed of one process against the bare simulator, of two workers against one, and memory.

The bare limit replays the same joint targets in the same world and calls nothing but
``stepSimulation``: what is left is the cost of observing, steering and counting.
"""

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

import minitouch_bench as mt
from minitouch_bench.simulation.client import pybullet
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import TASK_CLASSES
from tests.process_tree import descendants

RESETS = 30
EPISODES = 3
STEPS = 100


class Run(NamedTuple):
    """Seconds and control steps of one run, and the bare limit's seconds for the same ticks."""

    seconds: float
    bare_seconds: float
    steps: int
    ticks: int


def main() -> None:
    """Print all measurements."""
    console = Console(width=110)
    table = Table(title="One process, with observations, random actions", title_justify="left")
    for heading in ("task", "control steps/s", "ticks/step", "of the bare limit", "reset, median"):
        table.add_column(heading, justify="right" if heading != "task" else "left")
    for task in TASK_CLASSES:
        runs = [measure_steps(task, seed) for seed in range(EPISODES)]
        steps, ticks = sum(run.steps for run in runs), sum(run.ticks for run in runs)
        shares = [run.bare_seconds / run.seconds for run in runs]
        table.add_row(
            task,
            f"{steps / sum(run.seconds for run in runs):.0f}",
            f"{ticks / steps:.0f}",
            f"{statistics.median(shares):.0%} ({min(shares):.0%} to {max(shares):.0%})",
            f"{statistics.median(measure_resets(task)) * 1e3:.1f} ms",
        )
    console.print(table)
    measure_workers(console)


def measure_steps(task: str, seed: int) -> Run:
    """Time one episode of random actions, then its bare limit; episodes that end start anew."""
    environment = MiniTouchEnv(task, max_episode_steps=STEPS)
    rng = np.random.default_rng(seed)
    size = environment.action_space.shape[0]
    actions = rng.uniform(-1.0, 1.0, (STEPS, size)).astype(np.float32)
    calls: list[tuple] = []
    drive, step = environment.client.drive_joints, environment.client.step
    environment.reset(seed=seed)
    start = time.perf_counter()
    steps = play(environment, actions)
    seconds = time.perf_counter() - start

    environment.reset(seed=seed)
    environment.client.drive_joints = lambda *args: (calls.append([args, 0]), drive(*args))
    environment.client.step = lambda: (calls[-1].__setitem__(1, calls[-1][1] + 1), step())
    play(environment, actions)
    environment.client.drive_joints, environment.client.step = drive, step

    environment.reset(seed=seed)
    client_id = environment.client._bullet.id
    start = time.perf_counter()
    for arguments, ticks in calls:
        drive(*arguments)
        for _ in range(ticks):
            pybullet.stepSimulation(physicsClientId=client_id)
    bare_seconds = time.perf_counter() - start
    environment.close()
    return Run(seconds, bare_seconds, steps, sum(ticks for _, ticks in calls))


def play(environment: MiniTouchEnv, actions: np.ndarray) -> int:
    """Act until the episode ends; return the number of control steps."""
    for count, action in enumerate(actions, start=1):
        _, _, terminated, truncated, _ = environment.step(action)
        if terminated or truncated:
            return count
    return len(actions)


def measure_resets(task: str) -> list[float]:
    """Return the seconds of several resets."""
    environment = MiniTouchEnv(task)
    environment.reset(seed=0)
    found = []
    for seed in range(RESETS):
        start = time.perf_counter()
        environment.reset(seed=seed)
        found.append(time.perf_counter() - start)
    environment.close()
    return found


def measure_workers(console: Console) -> None:
    """Print the speed-up of two workers over one, and the memory of an evaluation with two."""
    seconds = {}
    for workers in (1, 2):
        with tempfile.TemporaryDirectory() as directory:
            command = [
                sys.executable, "-m", "minitouch_bench", "evaluate", "random",
                "--suite", "smoke", "--episodes", "8", "--workers", str(workers),
                "--output", f"{directory}/run",
            ]  # fmt: skip
            process = subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            peak = 0
            while process.poll() is None:
                peak = max(peak, tree_memory(process.pid))
                time.sleep(0.2)
            seconds[workers] = mt.load_run(f"{directory}/run").environment.wall_s
        console.print(
            f"{workers} workers: {seconds[workers]:.1f} s, peak memory {peak / 2**20:.0f} MiB"
        )
    console.print(f"two workers against one: {seconds[1] / seconds[2]:.2f} x")


def tree_memory(root: int) -> int:
    """Return the proportional set size (bytes) of a process and all below it."""
    total = 0
    for pid in (root, *descendants(root)):
        try:
            lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        except OSError:
            continue
        total += sum(int(line.split()[1]) * 1024 for line in lines if line.startswith("Pss:"))
    return total


if __name__ == "__main__":
    main()
