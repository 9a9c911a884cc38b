"""Speed of the environments beside the released MiniTouch package, in turn on one core.

``python -m benchmarks.release CLONE``: the path of a clone of github.com/ElementAI/MiniTouch. Needs
the package ``gym``, which that one imports.
"""

import os
import subprocess
import sys

import numpy as np

from minitouch_bench.protocol.minitouch import TASK_NAMES

ROUNDS, STEPS = 5, 200
RELEASED = {
    "playing": "Playing-v0", "pushing": "Pushing-v0",
    "opening": "Opening-v0", "pick-up": "Picking-v0",
}  # fmt: skip
"""The release's Gym ids of the tasks."""

DRIVER = """
import sys, time
import numpy as np
make = sys.argv[1]
if make == "release":
    import gym
    import minitouch.env
    environment = gym.make(sys.argv[2]).unwrapped
else:
    from minitouch_bench.tasks.environment import MiniTouchEnv
    environment = MiniTouchEnv(sys.argv[2])
size = environment.action_space.shape[0]
rng = np.random.default_rng(0)
for line in sys.stdin:
    started = time.process_time()
    environment.reset()
    reset = time.process_time() - started
    steps = int(line)
    started = time.process_time()
    for _ in range(steps):
        outcome = environment.step(rng.uniform(-1, 1, size).astype(np.float32))
    print(steps / (time.process_time() - started), reset, flush=True)
"""
"""Answers each line, a number of steps, by steps per second and the seconds of a reset."""


def main() -> None:
    """Print control steps per second and resets of both, and the ratios of the medians."""
    clone = sys.argv[1]
    for task in TASK_NAMES:
        ours = start("ours", task, {})
        theirs = start("release", RELEASED[task], {"PYTHONPATH": f"{clone}/src"})
        measured = np.array([[measure(ours), measure(theirs)] for _ in range(ROUNDS)])
        (rate, reset), (their_rate, their_reset) = np.median(measured, axis=0)
        print(
            f"{task}: {rate:.0f} against {their_rate:.1f} control steps/s, {rate / their_rate:.1f} "
            f"times; a reset {1000 * reset:.0f} against {1000 * their_reset:.0f} ms, "
            f"{their_reset / reset:.0f} times"
        )
        for process in (ours, theirs):
            process.kill()


def start(kind: str, name: str, variables: dict[str, str]) -> "subprocess.Popen[str]":
    """Start a process that measures one environment on demand."""
    paths = [variables.get("PYTHONPATH", ""), os.environ.get("PYTHONPATH", "")]
    return subprocess.Popen(
        [sys.executable, "-c", DRIVER, kind, name],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
    )


def measure(process: "subprocess.Popen[str]") -> tuple[float, float]:
    """Return control steps per second and the seconds of a reset."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{STEPS}\n")
    process.stdin.flush()
    for line in process.stdout:  # the release prints while it loads
        words = line.split()
        if len(words) == 2 and words[0][0].isdigit():
            return float(words[0]), float(words[1])
    sys.exit("an environment ended, as is said above")


if __name__ == "__main__":
    main()
