"""The script that validates the submission of a pull request, and what it leaves."""

import json
import shutil
import sys

import check_submission
import post_report
import pytest

from tests.process_tree import git

VALIDATE = """
import pathlib, sys
if sys.argv[1] == "build":
    pathlib.Path(sys.argv[3]).mkdir(parents=True)
    raise SystemExit
place = pathlib.Path(sys.argv[-1])
code = int((place / "code").read_text())
print(" ".join(sys.argv[1:]))
if code == 3:
    raise RuntimeError("a fault of the program")
print(f"{int(code == 0)} of 1 valid", file=sys.stderr)
if code == 0:
    proofs = place.parent / "_proofs"
    proofs.mkdir(exist_ok=True)
    (proofs / f"{place.name}.json").write_text("{}")
raise SystemExit(code)
"""


def commit(clone, **files):
    """Commit files, whose names have two underscores for each slash; return the commit."""
    for name, text in files.items():
        path = clone / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    git(clone, "add", "-A")
    git(clone, "commit", "-q", "-m", "change")
    return git(clone, "rev-parse", "HEAD")


@pytest.fixture
def script(tmp_path, monkeypatch):
    """The script, whose own clone is small and whose command is a stand-in."""
    (tmp_path / "own" / "submissions" / "_proofs").mkdir(parents=True)
    (tmp_path / "own" / "submissions" / "_proofs" / "mine.json").write_text('{"old": true}')
    monkeypatch.setattr(check_submission, "ROOT", tmp_path / "own")
    monkeypatch.setattr(check_submission, "COMMAND", (sys.executable, "-c", VALIDATE))
    for name in ("GITHUB_STEP_SUMMARY", "GITHUB_OUTPUT"):
        monkeypatch.setenv(name, str(tmp_path / name))
    return check_submission


@pytest.fixture
def clone(tmp_path):
    folder = tmp_path / "clone"
    folder.mkdir()
    git(folder, "init", "-q")
    return folder


def run(script, clone, head, *arguments):
    """Run it; return its exit code, result and folder."""
    output = clone.parent / "checked"
    options = ["--clone", str(clone), "--head", head, "--output", str(output), *arguments]
    code = script.main(options)
    return code, json.loads((output / "result.json").read_text()), output


def test_a_valid_submission_leaves_its_proof_and_a_summary(script, clone, tmp_path):
    base = commit(clone, README="")
    head = commit(clone, submissions__mine__code="0")
    code, result, output = run(script, clone, head, "--base", base, "--only-one")
    assert code == 0
    assert result == {"head": head, "outcomes": {"mine": "valid"}}
    text = (output / "output.txt").read_text()
    assert text.startswith("validate --prove submissions/mine")
    assert (output / "proofs" / "mine.json").read_text() == "{}"  # not the old one
    assert (output / "leaderboard").is_dir()
    assert "| `mine` | valid |" in (tmp_path / "GITHUB_STEP_SUMMARY").read_text()
    assert (tmp_path / "GITHUB_OUTPUT").read_text() == "proofs=1\n"


@pytest.mark.parametrize(
    ("code", "outcome"),
    [
        (1, "refused"),
        (5, "not finished"),
        (70, "the check failed with exit code 70"),
        (3, "the check failed with exit code 1"),
    ],
)
def test_any_other_outcome_is_named_and_leaves_no_proof(script, clone, tmp_path, code, outcome):
    base = commit(clone, README="")
    head = commit(clone, submissions__mine__code=str(code))
    ended, result, output = run(script, clone, head, "--base", base, "--only-one")
    assert ended == 1
    assert result["outcomes"] == {"mine": outcome}
    assert not (output / "proofs").exists()
    assert (tmp_path / "GITHUB_OUTPUT").read_text() == "proofs=0\n"


def test_the_end_of_a_long_output_is_kept_within_what_is_posted(script, tmp_path):
    script.report("é" * 30_000 + "the end", {}, "0", tmp_path)
    kept = (tmp_path / "output.txt").read_bytes()
    assert kept.endswith(b"the end")
    assert len(kept) <= post_report.MAX_TEXT


def test_a_change_that_removes_another_submission_is_not_checked(script, clone):
    base = commit(clone, README="", submissions__honest__code="0")
    shutil.rmtree(clone / "submissions" / "honest")
    removed = commit(clone)
    head = commit(clone, submissions__mine__code="0")
    assert run(script, clone, removed, "--base", base, "--only-one")[0] == 1
    code, result, output = run(script, clone, head, "--base", base, "--only-one")
    assert code == 1
    assert result["outcomes"] == {"honest": "not checked", "mine": "not checked"}
    assert "'honest', 'mine'" in (output / "output.txt").read_text()
    assert run(script, clone, head, "--base", base)[1]["outcomes"] == {"mine": "valid"}


@pytest.mark.parametrize(
    "files",
    [
        {"submissions__mine__code": "0", "README": "also"},
        {"submissions__mine__code": "0", "submissions___proofs__mine.json": "{}"},
        {"submissions__mine__code": "0", "submissions__other__code": "0"},
    ],
)
def test_a_change_of_more_than_one_submission_is_not_checked(script, clone, files):
    base = commit(clone, README="")
    head = commit(clone, **files)
    code, result, output = run(script, clone, head, "--base", base, "--only-one")
    assert code == 1
    assert set(result["outcomes"].values()) <= {"not checked"}
    assert "nothing else" in (output / "output.txt").read_text()


def test_a_first_push_and_a_name_choose_too(script, clone):
    """After a merge every changed submission is proved."""
    base = commit(clone, submissions__old__code="1")
    head = commit(clone, submissions__one__code="0", submissions__two__code="1", README="")
    both = {"one": "valid", "two": "refused"}
    assert run(script, clone, head, "--base", base)[1]["outcomes"] == both
    outcomes = run(script, clone, head, "--base", "0" * 40)[1]["outcomes"]
    assert outcomes == {"old": "refused", **both}
    assert run(script, clone, head, "--name", "one")[1]["outcomes"] == {"one": "valid"}
    assert run(script, clone, head, "--name", "../one")[1]["outcomes"] == {}
