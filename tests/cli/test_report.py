import shutil

import pytest

from tests.cli.command import run


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
