"""Checking submissions and drawing the board, as a maintainer types it."""

import os
import re
import shutil
import subprocess

import pytest
from typer.testing import CliRunner

from minitouch_bench.commands.leaderboard import app
from minitouch_bench.errors import IncompleteCheckError, RunDirectoryError
from minitouch_bench.leaderboard.validation import SubmissionFindings
from minitouch_bench.verification.static_check import Problem
from tests.altered import ROOT
from tests.commands.command import COMMAND, run
from tests.leaderboard.synthetic import make_submission


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    root = tmp_path_factory.mktemp("board")
    make_submission(root / "submissions", "hac")
    make_submission(root / "submissions", "zero", 0.1, kind="zero")
    return root


@pytest.fixture
def root(sound, tmp_path):
    return shutil.copytree(sound, tmp_path / "root")


@pytest.fixture
def validate(monkeypatch, tmp_path):
    """Run the command where the check of each directory, by its name, finds this."""

    def run_command(*arguments, **results):
        places = [tmp_path / name for name in results]
        for place in places:
            place.mkdir()
        found = lambda place: SubmissionFindings(directory=place, **results[place.name])  # noqa: E731
        monkeypatch.setattr("minitouch_bench.leaderboard.validation.validate", found)
        return CliRunner().invoke(app, ["validate", *map(str, places), *arguments])

    return run_command


@pytest.mark.parametrize(("unchecked", "code"), [((True,), 6), ((True, False), 1)])
def test_a_submission_that_cannot_be_read_is_not_called_invalid(validate, unchecked, code):
    problems = tuple(Problem("run.json", "no", is_unchecked=one) for one in unchecked)
    assert validate(hac={"problems": problems}).exit_code == code


@pytest.mark.parametrize(("error", "code"), [(IncompleteCheckError, 5), (RunDirectoryError, 6)])
def test_a_check_that_cannot_be_finished_does_not_stop_the_others(validate, error, code):
    done = validate(first={"error": error("why")}, second={})
    assert done.exit_code == code
    assert done.stdout.splitlines() == ["first: why", "second: valid, self-reported"]
    assert done.stderr == "1 of 2 valid\n"


def test_a_proof_that_is_withdrawn_is_told(validate):
    done = validate(hac={"problems": (Problem("run.json", "no"),), "withdrawn": "verified"})
    assert done.exit_code == 1
    assert done.stdout.splitlines()[-1] == "hac: its proof (verified) is withdrawn"


def test_a_directory_that_is_not_there_is_a_wrong_argument(root):
    for name in ("nosuch", "submissions/hac/submission.toml", "x" * 300):
        done = run("leaderboard", "validate", "submissions/hac", name, directory=root)
        done.refused(2, name)
        assert done.out == ""


def test_every_fault_has_a_line_and_the_exit_code_is_1(root):
    (root / "submissions/hac/notes.txt").write_text("hello")
    (root / "submissions/hac/seed-0/table4/table4.csv").write_text("policy\n")
    done = run("leaderboard", "validate", "submissions/hac", "submissions/zero", directory=root)
    assert done.code == 1
    lines = done.out.splitlines()
    assert lines[-1] == "zero: valid, verified"
    assert any(line.startswith("hac: notes.txt: ") for line in lines)
    assert any("table4.csv: " in line for line in lines)
    assert "1 of 2 valid" in done.err


def test_a_board_is_built_and_a_bad_submission_does_not_stop_it(root):
    shutil.copytree(root / "submissions" / "hac", root / "submissions" / "bad")
    done = run("leaderboard", "build", directory=root)
    assert done.code == 0
    assert "bad: submission.toml: the name is 'hac', the directory 'bad'" in done.out
    assert done.out.splitlines()[-1] == "reports/leaderboard/index.html"
    assert "1 ranked, 0 without a rank, 0 of another protocol, 1 refused" in done.err
    names = {path.name for path in (root / "reports" / "leaderboard").iterdir()}
    assert {"index.html", "leaderboard.md", "leaderboard.json"} <= names


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


def test_a_submission_is_removed_with_its_proof_after_it_was_shown(root):
    asked = run("leaderboard", "remove", "hac", directory=root)
    assert (asked.code, asked.out) == (2, "")
    assert "--yes" in asked.err
    assert "submissions/hac/: 4 files" in asked.err
    assert "submissions/_proofs/hac.json: its proof" in asked.err
    assert (root / "submissions/hac/submission.toml").exists()
    done = run("leaderboard", "remove", "hac", "--yes", directory=root)
    assert done.code == 0, done.err
    assert done.out.splitlines() == ["submissions/hac", "submissions/_proofs/hac.json"]
    left = {path.name for path in (root / "submissions").rglob("*") if path.is_file()}
    assert left == {"zero.json", "run.json", "actions.npz", "submission.toml"}
    run("leaderboard", "remove", "hac", "--yes", directory=root).refused(2, "hac")


@pytest.mark.parametrize("name", ["_proofs", "..", "../submissions/hac", "hac/seed-0"])
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
