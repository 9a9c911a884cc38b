"""Rows of a study that come from the leaderboard's results."""

import shutil

import pandas as pd
import pytest

import minitouch_bench as mt
from experiments.grid import KEY
from experiments.played import collect, played_rows

SETTINGS = {"random_steps": 40, "evaluate_every": 0, "sac": {"batch_size": 8}}


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Return a study with one collected training, and its policy played as a row of ``hac``."""
    folder = tmp_path_factory.mktemp("played")
    training = mt.train(
        "opening", "hac", seed=3, exploration_steps=45, task_steps=0, settings=SETTINGS,
        output=folder / "training",
    )  # fmt: skip
    study, policy, row = (folder / name for name in ("study", "policy", "results/hac/seed-3"))
    study.mkdir()
    policy.mkdir()
    design = "tasks = ['opening']\nmethods = ['hac']\nseeds = [3]\nexploration_steps = [45]\n"
    (study / "design.toml").write_text(design)
    collect(training, study)
    (policy / "opening.safetensors").write_bytes((training / "final.safetensors").read_bytes())
    run = mt.evaluate(str(policy), tasks=["opening"], episodes=2, output=row / "table4", workers=1)
    return study, run


def test_rows_are_those_of_the_played_run(trained):
    study, run = trained
    rows = played_rows(study, run.directory.parents[2])
    assert rows["episodes"][KEY].drop_duplicates().to_numpy().tolist() == [
        ["opening", "hac", 3, 45]
    ]
    assert rows["episodes"]["success"].tolist() == run.episodes["success"].tolist()
    success = rows["estimates"].set_index("metric").loc["success"]
    assert success["value"] == run["opening"].success.value
    assert success["episodes"] == 2


def test_a_training_that_is_not_of_the_design_or_not_played_is_refused(trained, tmp_path):
    study, _ = trained
    design, training = tmp_path / "design.toml", study.parent / "training"
    design.write_text((study / "design.toml").read_text().replace("[3]", "[4]"))
    with pytest.raises(SystemExit, match="no training of"):
        collect(training, tmp_path)
    design.write_text((study / "design.toml").read_text())
    other = shutil.copytree(training, tmp_path / "training")
    config = (other / "config.toml").read_text()
    for before, after, words in (
        ("without = []", 'without = ["forces"]', "no training of"),
        ("[task_phase]\nsteps = 0", "[task_phase]\nsteps = 9", "ended after 45 of 54"),
    ):
        assert before in config
        (other / "config.toml").write_text(config.replace(before, after))
        with pytest.raises(SystemExit, match=words):
            collect(other, tmp_path)
    assert {*tmp_path.iterdir()} == {design, other}
    played_rows.cache_clear()
    with pytest.raises(SystemExit, match="has a row"):
        played_rows(study, tmp_path)


def test_a_row_of_another_policy_is_not_taken_for_the_training_s(trained, tmp_path):
    run, study = trained[1], shutil.copytree(trained[0], tmp_path / "study")
    file = study / "trainings.csv"
    file.write_text(file.read_text().replace(pd.read_csv(file)["final_policy"][0], "0" * 64))
    played_rows.cache_clear()
    with pytest.raises(SystemExit, match="other policies"):
        played_rows(study, run.directory.parents[2])
