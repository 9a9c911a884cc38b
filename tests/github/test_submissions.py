"""The script that checks the submission of a pull request, and plays rows after a merge."""

import json
import shutil
import sys

import post_report
import pytest

import submissions
from tests.process_tree import git

PROGRAM = """
import pathlib, sys
words = sys.argv[1:]
print(" ".join(words))
if words[:2] == ["leaderboard", "play"]:
    raise SystemExit(5 if "slow" in words else 0)
place = pathlib.Path("submissions", words[-1] if words[0] == "leaderboard" else words[1][12:])
if words[0] == "leaderboard":
    raise SystemExit(int((place / "code").read_text().split()[0]))
raise SystemExit(int((place.parent / "code").read_text().split()[int(place.name[5:])]))
"""

TRAININGS = "[[trainings]]\nseed = 1\n[[trainings]]\nseed = 2\n"


def mine(codes, more=""):
    """A submission of two trainings, and the codes of its check and of each one's episodes."""
    text = more + TRAININGS
    return {"submissions__mine__code": codes, "submissions__mine__submission.toml": text}


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
    (tmp_path / "own" / "submissions").mkdir(parents=True)
    monkeypatch.setattr(submissions, "ROOT", tmp_path / "own")
    monkeypatch.setattr(submissions, "COMMAND", (sys.executable, "-c", PROGRAM))
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "summary"))
    return submissions


@pytest.fixture
def clone(tmp_path):
    folder = tmp_path / "clone"
    folder.mkdir()
    git(folder, "init", "-q")
    return folder


def check(script, clone, head, base):
    """Check a change; return the exit code, the result and the text that is posted."""
    output = clone.parent / "checked"
    options = ["--clone", str(clone), "--head", head, "--base", base, "--output", str(output)]
    code = script.main(["check", *options])
    result = json.loads((output / "result.json").read_text())
    return code, result, (output / "output.txt").read_text()


def test_a_sound_submission_is_checked_and_plays_smoke(script, clone, tmp_path):
    base = commit(clone, README="")
    head = commit(clone, **mine("0 0 0"))
    code, result, text = check(script, clone, head, base)
    assert (code, result) == (0, {"head": head, "outcomes": {"mine": "sound"}})
    played = "evaluate submissions/mine/seed-{} --suite smoke\n"
    assert text == "leaderboard check mine\n" + played.format(1) + played.format(2)
    assert "| `mine` | sound |" in (tmp_path / "summary").read_text()


@pytest.mark.parametrize(
    ("codes", "outcome"),
    [
        ("1 0 0", "refused"),
        ("0 0 3", "refused"),
        ("0 4 3", "refused"),
        ("0 4 0", "sound, with policy faults"),
        ("0 5 0", "not finished"),
        ("0 6 0", "the check failed with exit code 6"),
    ],
)
def test_any_other_outcome_is_named(script, clone, codes, outcome):
    base = commit(clone, README="")
    head = commit(clone, **mine(codes))
    ended, result, _ = check(script, clone, head, base)
    assert result["outcomes"] == {"mine": outcome}
    assert ended == (0 if outcome.startswith("sound") else 1)


def test_a_submission_for_the_dark_alone_plays_in_the_dark(script, clone):
    base = commit(clone, README="")
    head = commit(clone, **mine("0 0 0", 'suites = ["dark"]\n'))
    code, _, text = check(script, clone, head, base)
    assert code == 0
    assert text.count("--suite dark --episodes 5") == 2


def test_the_end_of_a_long_output_is_kept_within_what_is_posted(script, tmp_path):
    script.report("é" * 30_000 + "the end", {}, "0", tmp_path)
    kept = (tmp_path / "output.txt").read_bytes()
    assert kept.endswith(b"the end")
    assert len(kept) <= post_report.MAX_TEXT


@pytest.mark.parametrize(
    "more", [{}, {"submissions__mine__code": "0 0"}], ids=["alone", "beside another"]
)
def test_a_change_that_removes_another_submission_is_not_checked(script, clone, more):
    base = commit(clone, README="", submissions__honest__code="0 0")
    shutil.rmtree(clone / "submissions" / "honest")
    code, result, _ = check(script, clone, commit(clone, **more), base)
    assert (code, result["outcomes"]["honest"]) == (1, "not checked")


@pytest.mark.parametrize(
    "files",
    [
        {"submissions__mine__code": "0 0", "README": "also"},
        {"submissions__mine__code": "0 0", "reports__results__mine__row.toml": ""},
        {"submissions__mine__code": "0 0", "submissions__other__code": "0 0"},
    ],
)
def test_a_change_of_more_than_one_submission_is_not_checked(script, clone, files):
    base = commit(clone, README="")
    head = commit(clone, **files)
    code, result, text = check(script, clone, head, base)
    assert code == 1
    assert set(result["outcomes"].values()) <= {"not checked"}
    assert "nothing else" in text


def test_after_a_merge_every_changed_submission_is_played(script, clone, capsys):
    base = commit(clone, submissions__old__code="")
    head = commit(clone, submissions__one__code="", submissions__two__code="", README="")
    for options, names, code in (
        (("--base", base, "--head", head), ["one", "two"], 0),
        (("--base", "0" * 40, "--head", head), ["old", "one", "two"], 0),
        (("--base", head, "--head", head, "--name", "one"), ["one"], 0),
        (("--base", head, "--head", head), [], 0),
        (("--name", "../one"), [], 2),
    ):
        assert script.main(["names", "--clone", str(clone), *options]) == code
        assert capsys.readouterr().out == f"names={json.dumps(names)}\n"


def test_a_row_goes_on_unless_it_was_played_elsewhere_since(script, clone, capsys):
    commit(clone, submissions__one__code="")
    played, kept = (clone / place / "one" for place in ("played", "reports/results"))

    def play(name="one"):
        return script.main(["play", "--clone", str(clone), "--name", name])

    assert play() == 0
    assert "leaderboard play one --results played --stop-after 5h" in capsys.readouterr().out
    for folder, text in ((played, "draws = [1]"), (kept, "draws = [1]")):
        folder.mkdir(parents=True)
        (folder / "row.toml").write_text(text)
    for text in ('waiting = "a"\ndraws = [1]', "draws = [1, 3]", "draws = [3]\nretired = [1]"):
        (played / "row.toml").write_text(text)  # as it went on from what is kept
        play()
        assert (played / "row.toml").read_text() == text
    (kept / "row.toml").write_text("draws = [2]")
    play()
    assert (played / "row.toml").read_text() == "draws = [2]"
    assert play("slow") == 5
