"""The command, killed at random moments of both phases, ends in the bits of a quiet run."""

import random
import signal
import time

import pytest

from minitouch_bench.agents.training_directory import CHECKPOINT_FILE
from tests.agents.trainings import outcome, rows
from tests.commands import command

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

KILLS = 5
SETTINGS = """
random_steps = 50
log_every = 10
evaluate_every = 0
checkpoint_every = 15
[exploration]
steps = 300
[task_phase]
steps = 300
n_step = 3
[sac]
batch_size = 8
[curiosity]
width = 0.25
"""


def start(directory, *options):
    (directory.parent / "settings.toml").write_text(SETTINGS)
    options = ("--config", "settings.toml", "--output", directory, "--device", "cpu", *options)
    return command.start("train", "opening", *options, directory=directory.parent)


def end_of(process):
    """Return a command's exit code and what it told its user."""
    _, told = process.communicate()
    return process.returncode, told


def phase(directory):
    found = rows(directory)
    return found[-1]["phase"] if found else "exploration"


def test_killed_at_random_moments_in_both_phases(tmp_path):
    """One of the kills meets the switch, where keypoints and new networks are learned."""
    quiet, killed = tmp_path / "quiet", tmp_path / "killed"
    code, told = end_of(start(quiet))
    assert code == 0, told
    moments, options = random.Random(0), []
    for wanted in ["exploration"] * KILLS + ["switch"] + ["task"] * KILLS:
        began = time.time()
        process = start(killed, *options)
        while not is_reached(killed, wanted, began):
            assert process.poll() is None, end_of(process)
            time.sleep(0.02)
        time.sleep(moments.uniform(0.0, 0.3))
        process.kill()
        assert end_of(process)[0] == -signal.SIGKILL
        assert phase(killed) == ("task" if wanted == "task" else "exploration")
        options = ["--resume"]
    code, told = end_of(start(killed, *options))
    assert code == 0, told
    assert outcome(killed) == outcome(quiet)


def is_reached(directory, wanted, began):
    """Tell whether a training that began then has met the switch, or kept its state in a phase."""
    if wanted == "switch":
        return (directory / "exploration.safetensors").exists()
    file = directory / CHECKPOINT_FILE
    return file.exists() and file.stat().st_mtime > began and phase(directory) == wanted


def test_ctrl_c_says_how_to_go_on(tmp_path):
    process = start(tmp_path / "run")
    while not rows(tmp_path / "run"):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    code, told = end_of(process)
    assert code == 130
    assert "--resume" in told
