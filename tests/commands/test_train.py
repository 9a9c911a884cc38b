"""What the options of ``train`` change; no training is run."""

from dataclasses import replace
from pathlib import Path

import pytest

from minitouch_bench.agents import training_directory
from minitouch_bench.agents.config import make_config
from tests.commands.command import run, succeed


@pytest.fixture
def train(tmp_path, monkeypatch):
    """Return a function that gives the command options, and what it then would train and where."""
    asked = []

    def run_training(config, directory, **how):
        asked.append((config, directory, how))
        return True

    monkeypatch.setattr(training_directory, "run_training", run_training)

    def train(*options):
        succeed("train", *options, directory=tmp_path)
        return asked.pop()

    return train


def test_each_option_changes_its_own_setting_alone(train):
    base = make_config("pushing")
    steps = {"exploration": replace(base.exploration, steps=70)}
    lacking = {"without": ("forces", "vision")}
    both = {
        phase: replace(getattr(base, phase), **lacking) for phase in ("exploration", "task_phase")
    }
    for option, text, change in (
        ("--method", "rnd", {"method": "rnd"}),
        ("--seed", 3, {"seed": 3}),
        ("--exploration-steps", 70, steps),
        ("--task-steps", 0, {"task_phase": replace(base.task_phase, steps=0)}),
        ("--objects", "held-out", {"objects": "held-out"}),
        ("--without", "forces,vision", both),
        ("--task-without", "vision", {"task_phase": replace(base.task_phase, without=("vision",))}),
        ("--from-log", "log", {"dataset": "log"}),
    ):
        assert replace(base, **change) != base
        assert train("pushing", option, text)[0] == replace(base, **change), option


def test_senses_of_the_task_phase_name_the_directory(train):
    options = ("--without", "forces", "--task-without", "vision")
    config, directory, _ = train("opening", *options)
    assert config.exploration.without == ("forces",)
    assert config.task_phase.without == ("forces", "vision")
    assert directory == Path("reports/training/opening-hac-no-forces-task-no-vision-0")


def test_senses_of_a_phase_that_there_is_not_are_refused(tmp_path):
    (tmp_path / "task.toml").write_text('task_phase.without = ["vision"]')
    (tmp_path / "explore.toml").write_text('exploration.without = ["vision"]')
    for arguments, word in (
        (("playing", "--task-without", "vision"), "needs a task phase"),
        (("opening", "--task-without", "smell"), "no sense 'smell'"),
        (("playing", "--config", "task.toml"), "needs a task phase"),
        (("opening", "--method", "sac", "--config", "explore.toml"), "needs an exploration"),
    ):
        run("train", *arguments, directory=tmp_path).refused(2, word)


def test_an_option_counts_more_than_a_file_and_names_the_directory(train, tmp_path):
    (tmp_path / "file.toml").write_text('seed = 5\nmethod = "rnd"\n')
    options = ("--config", "file.toml", "--seed", 0, "--without", "forces", "--device", "cpu")
    config, directory, how = train("opening", *options, "--resume")
    phases = {phase: {"without": ["forces"]} for phase in ("exploration", "task_phase")}
    assert config == make_config("opening", settings={"method": "rnd", **phases})
    assert directory == Path("reports/training/opening-rnd-no-forces-0")
    assert (how["device"], how["resume"], how["fresh"]) == ("cpu", True, False)
