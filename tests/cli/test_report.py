import json
import os
import shutil
from pathlib import Path

import pytest

from tests.cli.command import run

SUBMISSION = Path(__file__).parents[2] / "submissions" / "open-loop" / "submission.toml"


def test_one_run_is_shown_and_drawn_again(scripted, tmp_path):
    copy = tmp_path / "again"
    shutil.copytree(scripted[1], copy)
    (copy / "report.html").unlink()
    done = run("report", copy, directory=tmp_path)
    assert done.code == 0
    assert "Success" in done.out
    assert (copy / "report.html").exists()


def test_several_runs_stand_side_by_side(scripted, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(scripted[1], other)
    done = run("report", scripted[1], other, "--output", tmp_path / "both", directory=tmp_path)
    assert done.code == 0
    page = (tmp_path / "both" / "report.md").read_text()
    assert page.count("scripted") > 1
    assert "Pushing" in page
    assert (tmp_path / "both" / "report.html").exists()


@pytest.mark.parametrize("content", [None, "no json"])
def test_what_is_no_run_is_refused(tmp_path, content):
    directory = tmp_path / "none"
    directory.mkdir()
    if content is not None:
        (directory / "run.json").write_text(content)
    run("report", directory, directory=tmp_path).refused(6, "none")


def test_runs_are_called_what_the_user_says(scripted, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(scripted[1], other)
    both = (scripted[1], other)
    done = run("report", *both, "--names", "old, new", "--output", "both", directory=tmp_path)
    assert done.code == 0
    page = (tmp_path / "both" / "report.html").read_text()
    assert ">old</p>" in page
    assert ">new</p>" in page
    for names in ("one", "same,same", "a,"):
        run("report", *both, "--names", names, directory=tmp_path).refused(2, "names")


def test_table_4_is_printed_as_latex_and_figures_are_written(scripted, tmp_path):
    copy = tmp_path / "run"
    shutil.copytree(scripted[1], copy)
    done = run("report", copy, "--latex", "--figures", "figures", directory=tmp_path)
    assert done.code == 0
    assert r"\toprule" in done.out
    assert "\u2191" not in done.out
    names = {path.name for path in (tmp_path / "figures").iterdir()}
    assert {"against-the-paper.svg", "against-the-paper.pdf", "episode-steps.pdf"} <= names


def test_a_learning_curve_with_its_numbers_and_figures(scripted, tmp_path):
    for name in ("early", "late"):
        shutil.copytree(scripted[1], tmp_path / name)
    both = ("report", "early", "late", "--output", "both", "--curve")
    run(*both, directory=tmp_path).refused(2, "--steps")
    run(*both, "--steps", "10,x", directory=tmp_path).refused(2, "--steps", "'x'")
    done = run(*both, "--steps", "10,20", "--figures", "figures", directory=tmp_path)
    assert done.code == 0, done.err
    assert "Learning curve" in done.out
    assert (tmp_path / "both" / "learning-curve.csv").read_text().count("\n") == 5
    assert {"learning-curve.svg", "learning-curve.pdf"} <= set(os.listdir(tmp_path / "figures"))


def test_the_seeds_of_a_submission_are_one_method(scripted, tmp_path):
    for seed in (0, 1):
        place = tmp_path / "submissions" / "mine" / f"seed-{seed}" / "table4"
        shutil.copytree(scripted[1], place)
        document = json.loads((place / "run.json").read_text())
        document["header"]["policy"]["digest"] = f"{seed}" * 64
        (place / "run.json").write_text(json.dumps(document))
    shutil.copy(SUBMISSION, tmp_path / "submissions" / "mine")
    runs = [f"submissions/mine/seed-{seed}/table4" for seed in (0, 1)]
    done = run("report", *runs, scripted[1], "--output", "both", directory=tmp_path)
    assert done.code == 0, done.err
    rows = [line.split() for line in done.out.splitlines() if line.endswith("training seeds ")]
    assert [row[0] for row in rows] == ["open-loop"]
