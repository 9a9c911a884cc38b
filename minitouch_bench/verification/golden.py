"""Golden digests: what one short episode of each task must look like, bit for bit.

A task's digest covers its values; code that changes an episode without changing a value shows
here. ``python -m minitouch_bench.verification.golden`` records the digests again, after the
task's revision was raised.
"""

import hashlib
import json
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL, TASK_NAMES
from minitouch_bench.tasks.environment import MiniTouchEnv

FILE = "golden.json"
SEED = 20211108
STEPS = 25
"""Random control steps: long enough to reach contact in most tasks."""


@dataclass(frozen=True)
class Golden:
    """What was recorded of a task: its digest then, and the digest of its golden episode."""

    task_digest: str
    bits: str


def golden_bits(task: str) -> str:
    """Return the SHA-256 over all that is observed in the task's golden episode."""
    sha = hashlib.sha256()
    environment = MiniTouchEnv(task)
    rng = np.random.default_rng(SEED)
    try:
        observation, info = environment.reset(seed=SEED)
        for _ in range(STEPS):
            for array in (observation["image"], observation["touch"], info["object_state"]):
                sha.update(array.tobytes())
            size = environment.action_space.shape
            action = rng.uniform(-1.0, 1.0, size).astype(np.float32)
            observation, _, terminated, _, info = environment.step(action)
            sha.update(f"{info['ticks']} {info['contact_ticks']}".encode())
            if terminated:
                break
        sha.update(observation["image"].tobytes())
    finally:
        environment.close()
    return sha.hexdigest()


def recorded() -> dict[str, Golden]:
    """Return the recorded golden digests by task."""
    text = files("minitouch_bench.verification").joinpath(FILE).read_text("utf-8")
    return {task: Golden(**entry) for task, entry in json.loads(text).items()}


def record() -> None:
    """Write the golden digests of all tasks as this machine computes them."""
    content = {
        task: {"task_digest": PROTOCOL.task_digest(task, MAIN_SUITE), "bits": golden_bits(task)}
        for task in TASK_NAMES
    }
    path = Path(__file__).with_name(FILE)
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    record()
