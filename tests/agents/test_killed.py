"""The command, killed at random moments of both phases, ends in the bits of a quiet run."""

import csv
import os
import random
import signal
import subprocess
import sys
import time

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

KILLS = 5
SETTINGS = """
random_steps = 50
log_every = 10
evaluate_every = 0
checkpoint_every = 15
[exploration]
steps = 150
[task_phase]
steps = 150
n_step = 3
[sac]
batch_size = 8
[curiosity]
width = 0.25
"""


def start(directory, *options):
    file = directory.parent / "settings.toml"
    file.write_text(SETTINGS)
    with notes_of(directory).open("a") as notes:
        return subprocess.Popen(
            [
                sys.executable, "-m", "minitouch_bench", "train", "opening",
                "--config", str(file), "--output", str(directory), "--device", "cpu", *options,
            ],
            stderr=notes, stdout=subprocess.DEVNULL,
        )  # fmt: skip


def notes_of(directory):
    return directory.parent / f"{directory.name}.txt"


def rows(directory):
    file = directory / "progress.csv"
    if not file.exists():
        return []
    with file.open() as lines:
        return [{**row, "seconds": ""} for row in csv.DictReader(lines)]


def phase(directory):
    found = rows(directory)
    return found[-1]["phase"] if found else "exploration"


def test_killed_at_random_moments_in_both_phases(tmp_path):
    """One of the kills meets the switch, where keypoints and new networks are learned."""
    quiet, killed = tmp_path / "quiet", tmp_path / "killed"
    assert start(quiet).wait() == 0
    moments, options, landed = random.Random(0), [], set()
    reached = {
        "exploration": lambda: phase(killed) == "exploration",
        "switch": (killed / "exploration.safetensors").exists,
        "task": lambda: phase(killed) == "task",
    }
    for wanted in ["exploration"] * KILLS + ["switch"] + ["task"] * KILLS:
        process = start(killed, *options)
        while not reached[wanted]() and process.poll() is None:
            time.sleep(0.05)
        time.sleep(moments.uniform(1.0, 4.0))
        process.send_signal(signal.SIGKILL)
        if process.wait() == -signal.SIGKILL:
            landed.add(wanted)
            if wanted == "switch":
                assert phase(killed) == "exploration"
        options = ["--resume"] if (killed / "config.toml").exists() else []
    process = start(killed, *options)
    assert process.wait() == 0, notes_of(killed).read_text()
    assert landed == {*reached}
    assert rows(killed) == rows(quiet)
    for name in ("exploration.safetensors", "final.safetensors"):
        assert (killed / name).read_bytes() == (quiet / name).read_bytes()


def test_ctrl_c_says_how_to_go_on(tmp_path):
    process = start(tmp_path / "run")
    while not rows(tmp_path / "run"):
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    assert process.wait() == 130
    assert "--resume" in notes_of(tmp_path / "run").read_text()
