"""Policies for whole runs."""

import atexit
import os
import signal
import subprocess
from pathlib import Path

import numpy as np


def die_if_due(*above: str) -> None:
    """Kill this process, or the one above these, as often as a file says."""
    file = Path(os.environ["DEATHS"])
    if left := int(file.read_text()):
        file.write_text(str(left - 1))
        process = os.getpid()
        for _ in above:
            process = int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
        os.kill(process, signal.SIGKILL)
        signal.pause()


class Still:
    steps = 0

    def reset(self, seed, task):
        self.task = task

    def act(self, observation):
        self.steps += 1
        return np.zeros(5, np.float32)


class Greedy(Still):
    """Takes memory, and is killed as where there is no more."""

    def act(self, observation):
        if observation["touch"].any():  # it is no trial
            self.taken = b"x" * 400 * 2**20
            os.kill(os.getpid(), signal.SIGKILL)
        return np.zeros(5, np.float32)


class Sensitive(Still):
    """Acts on every number that it senses, and is at fault at its fourth step."""

    def act(self, observation):
        super().act(observation)
        if self.steps == 4:
            raise ValueError("seen enough")
        seen = [observation["image"].astype(float).std(), *observation["touch"].astype(float)]
        return np.sin(1000 * np.sum(seen) + np.arange(4)).astype(np.float32)


class FaultInPushing(Still):
    """Is at fault at the third step, in one task."""

    def act(self, observation):
        super().act(observation)
        return np.full(5, np.nan if self.task == "pushing" and self.steps == 3 else 0.1, np.float32)


class Hopeless(Still):
    """Fails at once, except in the episode whose seed is named."""

    def reset(self, seed, task):
        if str(seed) != os.environ.get("FINE"):
            raise ValueError("nothing learned")


class Talks(Still):
    """Prints whenever it is called, and when Python ends; past Python, and from a child, too."""

    def __init__(self):
        print("made")
        subprocess.run(["echo", "from-a-child"], check=True)
        atexit.register(print, "gone")

    def reset(self, seed, task):
        print("begun")

    def act(self, observation):
        os.write(1, b"acting\n")
        return super().act(observation)

    def close(self):
        print("ended")


class ReadsItsRun(Still):
    """Reads what the run knows of earlier episodes; it lies in the working directory."""

    def act(self, observation):
        Path("run/run.journal").read_bytes()
        return super().act(observation)


class KillsItsWorkerOnce(Still):
    """Kills the worker process, which is the parent of its host; how often, a file says."""

    def act(self, observation):
        die_if_due("host", "worker")
        return super().act(observation)


class IsKilled(Still):
    """Is killed at its third step, so many times as a file says."""

    def act(self, observation):
        if self.steps == 2:
            die_if_due()
        return super().act(observation)
