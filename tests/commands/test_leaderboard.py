import json
import re
import shutil

import pandas as pd
import pytest

import minitouch_bench as mt
from minitouch_bench.files import lock_directory
from minitouch_bench.leaderboard.play import RowFacts
from tests.altered import ROOT
from tests.commands.command import run, succeed
from tests.leaderboard.playing import play_few
from tests.leaderboard.synthetic import make_row, make_submission


@pytest.fixture
def root(tmp_path):
    """A working directory with a row that was played, and a submission that was not."""
    make_row(tmp_path, "hac")
    make_submission(tmp_path / "submissions", "new")
    (tmp_path / "reports").mkdir()
    (tmp_path / "results").rename(tmp_path / "reports" / "results")
    return tmp_path


def test_every_problem_has_a_line_and_the_exit_code_is_1(root):
    (root / "submissions/hac/n\nnew: in order\x1b[8m").write_text("hello")
    (root / "submissions/hac/checkpoints/table4.csv").write_text("policy\n")
    done = run("leaderboard", "check", "hac", "new", "nosuch", directory=root)
    assert done.code == 1
    assert [line.split(":")[0] for line in done.out.splitlines()] == ["hac", "hac", "new", "nosuch"]
    assert "new: files and rules in order" in done.out
    assert "\x1b" not in done.out
    for name in ("new", "submissions/new/", root / "submissions" / "new"):
        assert succeed("leaderboard", "check", name, directory=root).out.startswith("new: ")
    nearby = run("compare", "reports/results/hac", "reports/results/hac", directory=root)
    nearby.refused(6, "seed-0/table4 in it is one")


def test_rows_are_played_and_a_broken_one_is_named(root, monkeypatch):
    (root / "submissions/new/notes.txt").write_text("hello")
    refused = run("leaderboard", "play", "hac", "new", directory=root)
    assert (refused.code, refused.out.partition(":")[0]) == (1, "new")
    for option, word in (
        ("--suite", "novel-shapes"),
        ("--stop-after", "5"),
        ("--stop-after", "0h"),
    ):
        run("leaderboard", "play", "hac", option, word, directory=root).refused(2, word)
    done = succeed("leaderboard", "play", "hac", directory=root)
    assert done.out == "reports/results/hac\n"
    assert "leaderboard build" in done.err
    monkeypatch.setattr(
        "minitouch_bench.leaderboard.play.play_row", lambda *_, **__: RowFacts(waiting="9 hours")
    )
    waits = run("leaderboard", "play", "hac", directory=root)
    assert (waits.code, waits.out) == (5, "hac: it stays waiting: 9 hours\n")


def test_a_row_that_is_stopped_says_how_it_goes_on(tmp_path, monkeypatch):
    play_few(monkeypatch, official=2)
    succeed("submit", "zero", "--name", "zero", directory=tmp_path)
    play = ("leaderboard", "play", "zero", "--workers", "1")
    stopped = run(*play, "--stop-after", "0.01s", directory=tmp_path)
    assert stopped.code == 5
    assert "stopped before the last episode" in stopped.err
    assert succeed(*play, directory=tmp_path).out == "reports/results/zero\n"


def test_a_board_is_built_and_a_bad_submission_does_not_stop_it(root):
    (root / "submissions" / "bad").mkdir()
    done = succeed("leaderboard", "build", directory=root)
    assert "bad: " in done.out
    assert "new: table4: not played yet" in done.out
    assert done.out.splitlines()[-1] == "reports/leaderboard/index.html"
    assert "1 ranked, 0 without a rank, 1 waiting, 1 left out" in done.err
    names = {path.name for path in (root / "reports" / "leaderboard").iterdir()}
    assert {"index.html", "leaderboard.md", "leaderboard.json"} <= names


def test_the_stored_leaderboard_is_what_is_built_today(tmp_path):
    """A submission that was merged after it, and waits to be played, is not in it."""
    stored = ROOT / "reports" / "leaderboard"
    mine, again = tmp_path / "submissions", tmp_path / "board"
    for name in re.findall(r'"name": "(.*?)"', (stored / "leaderboard.json").read_text()):
        if (one := ROOT / "submissions" / name).is_dir():
            shutil.copytree(one, mine / name)
    options = ("--submissions", mine, "--output", again)
    succeed("leaderboard", "build", *options, directory=ROOT)
    built, kept = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")}
        for folder in (again, stored)
    )
    assert built == kept, "make leaderboard"


def test_the_page_about_it_has_the_rows_of_today_and_of_the_dark():
    board = (ROOT / "reports" / "leaderboard" / "leaderboard.md").read_text().replace("\\", "")
    page = (ROOT / "docs" / "results" / "leaderboard.md").read_text()
    today, dark = page.partition("## In the dark")[::2]
    overall = board.partition("## Overall")[2].partition("\n## ")[0]
    rows = re.findall(r"(?m)^\| (\d.*?) \| (\S+) \| (.*?) \|", overall)
    assert [f"| `{name}` | {mean} | {rank} |" for rank, name, mean in rows] == re.findall(
        r"(?m)^\| `.*", today
    )
    of_dark = board.partition("## Dark")[2].partition("\n## ")[0]
    rows = re.findall(r"(?m)^\| `(\S+)` \| (.*) \| (.*) \| (.*) \|", dark)
    ranked = re.findall(r"(?m)^\| \d.*? \| (\S+) \|", of_dark)
    assert {name for name, *_ in rows} == {*ranked, "open-loop", "scripted"}
    for name, *shown in rows:
        (row,) = re.findall(rf"(?m)^\| \S.* \| {name}(?: \(calibration\))? \| .*", of_dark)
        cells = row.removesuffix(" |").split(" | ")[3:]
        assert shown == [cell.removesuffix(" seeds learned") for cell in cells]


def test_the_page_about_it_says_where_hac_fails_and_how_hard_it_presses():
    runs = (ROOT / "reports/results/hac").glob("seed-*/table4")
    episodes = pd.concat([mt.load_run(run).episodes for run in runs])
    page = " ".join((ROOT / "docs/results/leaderboard.md").read_text().split())
    goals = episodes[episodes["task"].isin(["pushing", "pick-up"])]
    count = goals.groupby(["task", "outcome"]).size()
    of = len(goals) // 2
    lost, slow = count["pushing", "left_workspace"], count["pushing", "step_limit"]
    assert f"Pushing fails in {lost + slow} of {of} episodes: {slow} reach" in page
    assert f"step limit, {lost} push" in page
    pick_up = goals[goals["task"] == "pick-up"]
    assert f"Pick-up fails in {(~pick_up['success']).sum()} of {of}: " in page
    assert f"{count['pick-up', 'left_workspace']} objects leave" in page
    board = json.loads((ROOT / "reports/leaderboard/leaderboard.json").read_text())
    (row,) = (one for one in board["ranked"] if one["name"] == "hac")
    force = row["figures"]["opening"]["peak_force"]
    assert f"{force['value']:.1f} N [{force['low']:.1f}, {force['high']:.1f}]" in page


def test_a_submission_is_removed_with_its_results(root):
    for name in (".packing", "..", "../submissions/hac", "hac/seed-0"):
        run("leaderboard", "remove", name, directory=root).refused(2, "no submission")
    assert (root / "submissions/hac/submission.toml").exists()
    with lock_directory(root / "reports/results/hac"):  # as it is played
        run("leaderboard", "remove", "hac", directory=root).refused(6, "in use")
    done = succeed("leaderboard", "remove", "hac", directory=root)
    assert done.out.splitlines() == ["submissions/hac", "reports/results/hac"]
    assert [*(root / "submissions").iterdir()] == [root / "submissions/new"]
    assert not [*(root / "reports/results").iterdir()]
    run("leaderboard", "remove", "hac", directory=root).refused(2, "hac")
