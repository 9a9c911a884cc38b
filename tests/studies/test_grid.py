"""A small grid for real: killed at any moment, it ends in the same rows."""

import hashlib
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict

import pandas as pd
import pytest

import minitouch_bench as mt
from experiments.grid import (
    FILES,
    Cell,
    add_rows,
    cells_of,
    evaluations_of,
    finish_cell,
    finished_cells,
    read_design,
    run_grid,
)
from experiments.reliance import WORDS
from tests.altered import ROOT
from tests.process_tree import descendants, is_alive, wait_until

DESIGN = """
tasks = ["playing", "opening"]
methods = ["hac", "rnd"]
seeds = [0]
exploration_steps = [60]
episodes = 1

[per_task.opening]
methods = ["rnd"]
task_steps = 30

[settings]
random_steps = 40
evaluate_every = 0
log_every = 20
checkpoint_every = 20
sac = { batch_size = 8 }

[[conditions]]
without = ["forces"]
perturb = ["mass=2:3"]
episodes = 2
tasks = ["opening"]

[reliance]
forces = ["late", "other"]
episodes = 1
methods = ["rnd"]
tasks = ["opening"]
"""

SHARED = """
tasks = ["opening"]
methods = ["hac", "feels"]
seeds = [0]
exploration_steps = [60]
explore_once = true
episodes = 1

[per_task.opening]
task_steps = 30

[arms.feels]
method = "hac"
task_without = ["vision"]

[settings]
random_steps = 40
evaluate_every = 0
sac = { batch_size = 8 }
task_phase = { keypoint_updates = 2, fitting_updates = 2 }
"""


@pytest.fixture
def design(tmp_path):
    file = tmp_path / "small.toml"
    file.write_text(DESIGN)
    return file


def test_several_grids_add_their_rows_at_a_time(tmp_path):
    cells = [Cell("opening", "hac", seed, 10) for seed in range(40)]

    def add(cell):
        add_rows(tmp_path, cell, {"curves": pd.DataFrame([asdict(cell)] * 50),
                                  "trainings": pd.DataFrame([asdict(cell)])})  # fmt: skip

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(add, cells))
    assert finished_cells(tmp_path / "curves.csv") == {*cells}
    assert len(pd.read_csv(tmp_path / "trainings.csv")) == len(cells)


def test_cells_and_their_runs(design):
    read = read_design(design)
    cells = {cell.name: cell for cell in cells_of(read)}
    assert [*cells] == ["playing-hac-60-0", "playing-rnd-60-0", "opening-rnd-60-0"]
    runs = {name: [*evaluations_of(read, cell)] for name, cell in cells.items()}
    assert runs["playing-hac-60-0"] == ["table4"]
    assert runs["opening-rnd-60-0"] == ["table4", "without-forces-perturb-mass=2-to-3-2"]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_killed_three_times_it_ends_in_the_rows_of_an_undisturbed_one(design, tmp_path):
    assert run_grid(design, tmp_path / "calm") == {}
    output, last = tmp_path / "killed", "opening-rnd-60-0"
    for file in (
        "playing-hac-60-0/checkpoint.pt",
        f"{last}/checkpoint.pt",
        f"{last}/final.safetensors",
    ):
        kill_once_there_is(output / file, start(design, output))
    assert run_grid(design, output) == {}
    for name in FILES:
        calm, killed = (pd.read_csv(place / f"{name}.csv") for place in (tmp_path / "calm", output))
        calm, killed = (one.drop(columns="seconds", errors="ignore") for one in (calm, killed))
        pd.testing.assert_frame_equal(calm, killed)
    assert {*pd.read_csv(output / "episodes.csv", keep_default_na=False)["conditions"]} == {
        "", "without forces, mass 2 to 3 times", *WORDS.values(),
    }  # fmt: skip


def start(design, output):
    command = [sys.executable, "-m", "experiments.grid", design, "--output", output]
    return subprocess.Popen(command, cwd=ROOT, start_new_session=True)


def wait_for(file, process):
    while not file.exists():
        assert process.poll() is None
        time.sleep(0.02)


def kill_once_there_is(file, process):
    wait_for(file, process)
    process.kill()
    process.wait()


@pytest.mark.slow
def test_ctrl_c_ends_a_grid_at_once(design, tmp_path):
    output = tmp_path / "out"
    process = start(design, output)
    wait_for(output / "playing-hac-60-0" / "checkpoint.pt", process)
    family = descendants(process.pid)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    assert process.wait(60) == 130
    wait_until(lambda: not any(map(is_alive, family)))
    assert not [*output.glob("*/final.safetensors")]
    assert not (output / "opening-rnd-60-0").exists()


@pytest.mark.slow
def test_a_failed_cell_is_named_and_the_others_are_finished(design, tmp_path):
    bad = tmp_path / "out" / "playing-hac-60-0"
    bad.mkdir(parents=True)
    (bad / "config.toml").write_text("seed = 7\n")  # of another training
    (bad / "progress.csv").write_text("")
    failed = run_grid(design, tmp_path / "out")
    assert [cell.name for cell in failed] == [bad.name]
    assert len(pd.read_csv(tmp_path / "out" / "trainings.csv")) == 2


@pytest.mark.parametrize(
    ("before", "word"), [("random_steps = 50", "settings"), ("task_steps = 40", "task_steps of op")]
)
def test_another_setting_needs_another_directory(design, tmp_path, before, word):
    output = tmp_path / "out"
    output.mkdir()
    name = before.split(" = ")[0]
    (output / "design.toml").write_text(re.sub(rf"{name} = \d+", before, DESIGN))
    with pytest.raises(SystemExit, match=word):
        run_grid(design, output)


def test_arms_that_share_an_exploration_learn_as_if_each_had_its_own(tmp_path):
    """The copied exploration gives the same bits as a training that does both phases itself."""
    file = tmp_path / "shared.toml"
    file.write_text(SHARED)
    assert run_grid(file, tmp_path / "out") == {}
    trainings = pd.read_csv(tmp_path / "out" / "trainings.csv").set_index("method")
    assert trainings["exploration_policy"].nunique() == 1
    assert trainings["final_policy"].nunique() == 2
    settings = tomllib.loads(SHARED)["settings"]
    alone = mt.train(
        "opening", "hac", seed=0, exploration_steps=60, task_steps=30, settings=settings,
        task_without=["vision"], output=tmp_path / "alone",
    )  # fmt: skip
    content = (alone / "final.safetensors").read_bytes()
    assert hashlib.sha256(content).hexdigest() == trainings.loc["feels", "final_policy"]


def test_a_training_killed_before_its_task_phase_does_not_count_as_finished(tmp_path, monkeypatch):
    file = tmp_path / "shared.toml"
    file.write_text(SHARED)
    design = read_design(file)
    cell, train = cells_of(design)[0], mt.train

    def explore_only(*args, task_steps, **options):
        if task_steps:
            raise KeyboardInterrupt
        return train(*args, task_steps=task_steps, **options)

    monkeypatch.setattr(mt, "train", explore_only)
    with pytest.raises(KeyboardInterrupt):
        finish_cell(design, cell, tmp_path)
    monkeypatch.undo()
    file.write_text(SHARED.replace("seeds = [0]", "seeds = [0, 1]"))  # and a seed is added
    row = finish_cell(read_design(file), cell, tmp_path)["trainings"].iloc[0]
    assert row["design"] == design["digest"]
    assert row["control_steps"] == "90"
    assert row["final_policy"] != row["exploration_policy"]
