"""Checking submissions and drawing the board, as a maintainer types it."""

import contextlib
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from minitouch_bench.cli.leaderboard import app, build
from minitouch_bench.errors import IncompleteCheckError, RunDirectoryError
from minitouch_bench.leaderboard.board import LeftOut, make_board
from minitouch_bench.verification.problems import Problem
from minitouch_bench.workflows.proving import Validation
from tests.cli.command import run
from tests.leaderboard.synthetic import make_submission

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    root = tmp_path_factory.mktemp("board")
    make_submission(root / "submissions", "hac")
    make_submission(root / "submissions", "zero", 0.1, kind="zero")
    return root


@pytest.fixture
def root(sound, tmp_path):
    return shutil.copytree(sound, tmp_path / "root")


def test_valid_submissions_are_named_with_their_level(root):
    done = run("leaderboard", "validate", "submissions/hac", "submissions/zero", directory=root)
    assert done.code == 0
    assert done.out == "hac: valid, re-run-verified\nzero: valid, re-run-verified\n"


@pytest.mark.parametrize("refused", [(), (LeftOut("hac", ("notes.txt: no such file",)),)])
def test_a_strict_build_fails_where_a_submission_is_refused(tmp_path, monkeypatch, refused):
    board = replace(make_board([]), refused=refused)
    monkeypatch.setattr("minitouch_bench.leaderboard.build.build_board", lambda *_: board)
    build(tmp_path, tmp_path, strict=False)
    expected = pytest.raises(typer.Exit) if refused else contextlib.nullcontext()
    with expected as end:
        build(tmp_path, tmp_path, strict=True)
    assert not refused or end.value.exit_code == 1


@pytest.fixture
def validate(monkeypatch):
    """Run the command where the check of each directory, by its name, has this result."""

    def run_command(*arguments, **results):
        def checked(directory, _):
            result = results[directory.name]
            if isinstance(result, Exception):
                raise result
            return result

        name = "minitouch_bench.workflows.proving.validate_submission"
        monkeypatch.setattr(name, checked)
        return CliRunner().invoke(app, ["validate", *results, *arguments])

    return run_command


@pytest.mark.parametrize(("unchecked", "code"), [((True,), 6), ((True, False), 1)])
def test_a_submission_that_cannot_be_read_is_not_called_invalid(validate, unchecked, code):
    problems = tuple(Problem("run.json", "no", is_unchecked=one) for one in unchecked)
    assert validate(hac=Validation(problems)).exit_code == code


def test_a_missing_checkpoint_does_not_stop_the_others(validate):
    missing = IncompleteCheckError("the final checkpoint of seed 0 is not in the submission")
    done = validate("--replay", first=missing, second=Validation((), "fresh-verified"))
    assert done.exit_code == 5
    assert done.stdout.splitlines() == [
        "first: the final checkpoint of seed 0 is not in the submission",
        "second: valid, fresh-verified",
    ]
    assert done.stderr == "1 of 2 valid\n"


def test_a_file_that_cannot_be_read_does_not_stop_the_others(validate):
    locked = RunDirectoryError("_proofs cannot be written: Permission denied")
    done = validate("--replay", first=locked, second=Validation((), "fresh-verified"))
    assert (done.exit_code, len(done.stdout.splitlines())) == (6, 2)


def test_a_proof_that_is_withdrawn_is_told(validate):
    done = validate(hac=Validation((Problem("run.json", "no"),), withdrawn="fresh-verified"))
    assert done.exit_code == 1
    assert done.stdout.splitlines()[-1] == "hac: its proof (fresh-verified) is withdrawn"


def test_too_few_fresh_episodes_are_told_before_they_are_played(validate):
    done = validate("--fresh-seeds", "19", hac=Validation((), "re-run-verified"))
    assert done.stderr.splitlines()[0].startswith("fewer than 20 fresh episodes")


def test_a_draw_that_could_be_guessed_is_refused(root):
    done = run("leaderboard", "validate", "submissions/hac", "--draw", "x" * 31, directory=root)
    done.refused(2, "--draw needs 32 characters")


def test_a_directory_that_is_not_there_is_named_once(tmp_path):
    done = run("leaderboard", "validate", "nosuch", directory=tmp_path)
    assert done.code == 1
    assert done.out == "nosuch: it is not a directory; give a submission's directory\n"


def test_every_fault_has_a_line_and_the_exit_code_is_1(root):
    (root / "submissions/hac/notes.txt").write_text("hello")
    (root / "submissions/hac/seed-0/table4/table4.csv").write_text("policy\n")
    done = run("leaderboard", "validate", "submissions/hac", "submissions/zero", directory=root)
    assert done.code == 1
    lines = done.out.splitlines()
    assert lines[-1] == "zero: valid, re-run-verified"
    assert "hac: notes.txt: a submission has no such file; remove it" in lines
    assert any("table4.csv: a submission has no such file" in line for line in lines)
    assert "1 of 2 valid" in done.err


def test_nothing_is_replayed_where_the_files_are_at_fault_already(root):
    (root / "submissions/hac/notes.txt").write_text("hello")
    shutil.rmtree(root / "submissions" / "_proofs")
    done = run("leaderboard", "validate", "submissions/hac", "--replay", directory=root)
    assert done.code == 1
    assert len(done.out.splitlines()) == 1
    assert not (root / "submissions" / "_proofs").exists()


def test_a_board_is_built_and_a_bad_submission_does_not_stop_it(root):
    shutil.copytree(root / "submissions" / "hac", root / "submissions" / "bad")
    done = run("leaderboard", "build", directory=root)
    assert done.code == 0
    assert "bad: submission.toml: the name is 'hac', the directory 'bad'" in done.out
    assert done.out.splitlines()[-1] == "reports/leaderboard/index.html"
    assert "1 ranked, 0 of another protocol, 1 refused" in done.err
    names = {path.name for path in (root / "reports" / "leaderboard").iterdir()}
    assert {"index.html", "leaderboard.md", "leaderboard.csv", "leaderboard.json"} <= names


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


def test_the_same_submissions_give_the_same_board(root):
    for place in ("one", "two"):
        assert run("leaderboard", "build", "--output", place, directory=root).code == 0
    for name in ("index.html", "leaderboard.md", "leaderboard.csv", "leaderboard.json"):
        assert (root / "one" / name).read_bytes() == (root / "two" / name).read_bytes()


def test_no_directory_of_submissions(tmp_path):
    run("leaderboard", "build", directory=tmp_path).refused(2, "no directory of submissions")


def test_a_link_to_itself_does_not_stop_the_leaderboard(root):
    (root / "submissions" / "loop").symlink_to("loop")
    done = run("leaderboard", "build", "--output", "site", directory=root)
    assert done.code == 0, done.err
    assert "1 ranked" in done.err
    assert "loop: it is not a directory" in done.out


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("leaderboard", "build", "--output", "site", "--submissions"), 2),
        (("submit", "--name", "mine", "--training-steps", "0"), 6),
    ],
)
def test_a_directory_that_cannot_be_looked_at_is_a_mistake_of_one_line(tmp_path, words, code):
    run(*words, "x" * 300, directory=tmp_path).refused(code, "File name too long")


def test_a_submission_that_cannot_be_looked_at_is_unchecked(tmp_path):
    done = run("leaderboard", "validate", "x" * 300, directory=tmp_path)
    assert done.code == 6
    assert "File name too long" in done.out
    assert "Traceback" not in done.err
