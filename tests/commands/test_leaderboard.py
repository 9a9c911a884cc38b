"""Checking submissions, playing rows and drawing the board, as a maintainer types it."""

import os
import re
import subprocess

import pytest

from minitouch_bench.leaderboard.entry import RowFacts
from tests.altered import ROOT
from tests.commands.command import COMMAND, run
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
    (root / "submissions/hac/notes.txt").write_text("hello")
    (root / "submissions/hac/checkpoints/table4.csv").write_text("policy\n")
    done = run("leaderboard", "check", "hac", "new", "nosuch", directory=root)
    assert done.code == 1
    assert [line.partition(":")[0] for line in done.out.splitlines()] == [
        "hac", "hac", "new", "nosuch"
    ]  # fmt: skip
    assert "new: sound" in done.out
    assert run("leaderboard", "check", "new", directory=root).code == 0


def test_rows_are_played_and_a_broken_one_is_named(root, monkeypatch):
    (root / "submissions/new/notes.txt").write_text("hello")
    refused = run("leaderboard", "play", "hac", "new", directory=root)
    assert (refused.code, refused.out.partition(":")[0]) == (1, "new")
    done = run("leaderboard", "play", "hac", directory=root)
    assert (done.code, done.out) == (0, "reports/results/hac\n")
    assert "leaderboard build" in done.err
    monkeypatch.setattr(
        "minitouch_bench.leaderboard.entry.play_row", lambda *_, **__: RowFacts(waiting="9 hours")
    )
    waits = run("leaderboard", "play", "hac", directory=root)
    assert (waits.code, waits.out) == (5, "hac: it stays waiting: 9 hours\n")


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--suite", "novel-shapes"), "hac is for table4"),
        (("--stop-after", "5"), "--stop-after"),
        (("--stop-after", "0h"), "--stop-after"),
        (("--stop-after", "soon"), "--stop-after"),
    ],
)
def test_mistakes_of_play_are_told(root, options, word):
    run("leaderboard", "play", "hac", *options, directory=root).refused(2, word)


def test_a_row_that_is_stopped_says_how_it_goes_on(tmp_path, monkeypatch):
    play_few(monkeypatch)
    assert run("submit", "zero", "--name", "zero", directory=tmp_path).code == 0
    arguments = ("leaderboard", "play", "zero", "--workers", "1")
    stopped = run(*arguments, "--stop-after", "0.01s", directory=tmp_path)
    assert stopped.code == 5
    assert "--stop-after" in stopped.err
    done = run(*arguments, directory=tmp_path)
    assert (done.code, done.out) == (0, "reports/results/zero\n")


def test_a_board_is_built_and_a_bad_submission_does_not_stop_it(root):
    (root / "submissions" / "bad").mkdir()
    done = run("leaderboard", "build", directory=root)
    assert done.code == 0
    assert "bad: " in done.out
    assert "new: table4: minitouch-bench leaderboard play new" in done.out
    assert done.out.splitlines()[-1] == "reports/leaderboard/index.html"
    assert "1 ranked, 0 without a rank, 1 waiting, 1 left out" in done.err
    names = {path.name for path in (root / "reports" / "leaderboard").iterdir()}
    assert {"index.html", "leaderboard.md", "leaderboard.json"} <= names
    (root / "mine").mkdir()
    (root / "mine" / "index.html").write_text("somebody's page")
    run("leaderboard", "build", "--output", "mine", directory=root).refused(6, "mine")


def test_the_stored_leaderboard_is_what_is_built_today(tmp_path):
    done = run("leaderboard", "build", "--output", tmp_path, directory=ROOT)
    assert done.code == 0
    stored = ROOT / "reports" / "leaderboard"
    built, kept = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")}
        for folder in (tmp_path, stored)
    )
    assert built == kept, "make leaderboard"


def test_the_page_about_it_has_the_learned_rows_of_today():
    board = (ROOT / "reports" / "leaderboard" / "leaderboard.md").read_text()
    overall = board.partition("## Overall")[2].partition("\n## ")[0].replace("\\", "")
    page = (ROOT / "docs" / "results" / "leaderboard.md").read_text()
    rows = re.findall(r"(?m)^\| (\d.*?) \| (\S+) \| (.*?) \|", overall)
    assert len(rows) == page.count("| `")
    for rank, name, mean in rows:
        assert f"| `{name}` | {mean} | {rank} |" in page


def test_a_submission_is_removed_with_its_results_after_they_were_shown(root):
    asked = run("leaderboard", "remove", "hac", directory=root)
    assert (asked.code, asked.out) == (2, "")
    assert "--yes" in asked.err
    assert "submissions/hac/\n" in asked.err
    assert "reports/results/hac/\n" in asked.err
    assert (root / "submissions/hac/submission.toml").exists()
    done = run("leaderboard", "remove", "hac", "--yes", directory=root)
    assert done.code == 0, done.err
    assert done.out.splitlines() == ["submissions/hac", "reports/results/hac"]
    assert not (root / "submissions/hac").exists()
    assert not (root / "reports/results/hac").exists()
    assert (root / "submissions/new").exists()
    run("leaderboard", "remove", "hac", "--yes", directory=root).refused(2, "hac")


@pytest.mark.parametrize("name", [".packing", "..", "../submissions/hac", "hac/seed-0"])
def test_only_a_submission_is_removed(root, name):
    run("leaderboard", "remove", name, "--yes", directory=root).refused(2, "no submission")
    assert (root / "submissions/hac/submission.toml").exists()


@pytest.mark.parametrize(("answer", "code"), [("y\n", 0), ("n\n", 1), ("\x04", 130)])
def test_a_terminal_is_asked_before_a_submission_is_removed(root, answer, code):
    keyboard, terminal = os.openpty()
    os.write(keyboard, answer.encode())
    command = [*COMMAND, "leaderboard", "remove", "hac"]
    done = subprocess.run(
        command, cwd=root, stdin=terminal, capture_output=True, text=True, check=False
    )
    assert "Remove hac?" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == code
    assert (root / "submissions/hac").exists() is (code > 0)
