import json
import os
import shutil

import pytest

from tests.commands.command import run, succeed


def test_a_run_is_drawn_again_and_its_folder_of_replays_neither_opened_nor_linked(copy, tmp_path):
    """A page that came with the run would be a stranger's, and a pipe would never end."""
    (copy / "report.html").unlink()
    digest = json.loads((copy / "run.json").read_text())["digest"]
    (copy / "replays").mkdir(exist_ok=True)
    (copy / "replays" / "pushing-0.html").write_text(f'<meta name="run" content="{digest}">')
    os.mkfifo(copy / "replays" / "pushing-1.html")
    assert "Success" in succeed("report", copy, directory=tmp_path).out
    assert "replays/" not in (copy / "report.html").read_text()


def test_the_report_of_another_run_is_not_replaced(scripted, tmp_path):
    for name in ("first", "second"):
        shutil.copytree(scripted[1], tmp_path / name)
    before = (tmp_path / "first" / "report.html").read_bytes()
    words = ("report", "second", "--output", "first")
    run(*words, directory=tmp_path).refused(6, "contains a run")
    run(*words, "first", directory=tmp_path).refused(6, "contains a run")
    assert (tmp_path / "first" / "report.html").read_bytes() == before


def test_a_part_of_a_run_does_not_replace_its_page(copy, tmp_path):
    succeed("report", copy, directory=tmp_path)
    before = (copy / "report.html").read_bytes()
    done = succeed("report", copy, "--metrics", "success", directory=tmp_path)
    assert (copy / "report.html").read_bytes() == before
    assert "reports/comparison/" in done.err
    onto = ("report", copy, "--metrics", "success", "--output", copy)
    run(*onto, directory=tmp_path).refused(6, "contains a run")


def test_runs_are_called_what_the_user_says(scripted, copy, tmp_path):
    both = (scripted[1], copy)
    succeed("report", *both, "--names", "old, new", "--output", "both", directory=tmp_path)
    page = (tmp_path / "both" / "report.html").read_text()
    assert ">old</p>" in page
    assert ">new</p>" in page
    for names in ("one", "same,same", "a,"):
        run("report", *both, "--names", names, directory=tmp_path).refused(2, "names")


@pytest.mark.parametrize(
    ("form", "words"),
    [("latex", r"\toprule"), ("md", "| Metric |"), ("csv", "policy,task,"), ("json", '"policy":')],
)
def test_table_4_is_printed_in_each_format_and_nothing_is_written(scripted, tmp_path, form, words):
    chosen = ("--tasks", "pushing", "--metrics", "success,touched")
    done = succeed("report", scripted[1], "--format", form, *chosen, directory=tmp_path)
    assert words in done.out
    assert "pushing" in done.out.lower()
    assert "touched" in done.out.lower()
    for unused in (("--output", "out"), ("--diagnostics",)):
        run("report", scripted[1], "--format", form, *unused, directory=tmp_path).refused(2)
    assert not [*tmp_path.iterdir()]
