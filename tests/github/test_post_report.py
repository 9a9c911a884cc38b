"""The comment on a pull request: what of a stranger's files and names can get into it."""

import json
import sys

import post_report
import pytest

HEAD = "a" * 40
GH = """import json, os, pathlib, sys
at = pathlib.Path(os.environ["FAKE"])
place = sys.argv[2].removeprefix("repos/owner/bench/")
given = sys.stdin.read() if "--input" in sys.argv else ""
with (at / "calls").open("a") as file:
    file.write(json.dumps([place, sys.argv[3:], given]) + "\\n")
answers = json.loads((at / "answers").read_text())
calls = [json.loads(line)[0] for line in (at / "calls").read_text().splitlines()]
again = f"{place} again" if calls.count(place) > 1 else ""
print(json.dumps(answers.get(again, answers.get(place.partition("?")[0], {}))))
"""


@pytest.fixture
def github(tmp_path, monkeypatch):
    """A stand-in of ``gh`` that answers for one pull request, and notes its calls."""
    command = tmp_path / "bin" / "gh"
    command.parent.mkdir()
    (tmp_path / "gh.py").write_text(GH)
    # By way of a shell: a first line names no program whose path has a space.
    command.write_text(f"#!/bin/sh\nexec '{sys.executable}' '{tmp_path / 'gh.py'}' \"$@\"\n")
    command.chmod(0o755)
    variables = {
        "PATH": command.parent, "FAKE": tmp_path, "GITHUB_REPOSITORY": "owner/bench",
        "HEAD_SHA": HEAD, "HEAD_OWNER": "stranger", "HEAD_BRANCH": "patch",
        "RUN_URL": "https://example.org/run", "CHECKED": tmp_path / "checked",
    }  # fmt: skip
    for name, value in variables.items():
        monkeypatch.setenv(name, str(value))
    (tmp_path / "checked").mkdir()

    def post(
        files=("submissions/mine/submission.toml",), head=HEAD, comments=(), status="added",
        head_later=HEAD,
    ):  # fmt: skip
        answers = {
            "pulls": [{"number": 7, "head": {"sha": head}, "base": {"ref": "main"}}],
            "pulls again": [{"number": 7, "head": {"sha": head_later}, "base": {"ref": "main"}}],
            "pulls/7/files": [[{"filename": name, "status": status} for name in files]],
            "issues/7/comments": [list(comments)],
        }
        (tmp_path / "answers").write_text(json.dumps(answers))
        (tmp_path / "calls").unlink(missing_ok=True)
        assert post_report.main() == 0
        lines = (tmp_path / "calls").read_text().splitlines()
        place, options, given = json.loads(lines[-1])
        return place, options, json.loads(given)["body"] if given else ""

    return post


def leave(tmp_path, outcome="sound", text="mine: sound\n", head=HEAD):
    """Write what the checking job leaves."""
    result = json.dumps({"head": head, "outcomes": {"mine": outcome}})
    (tmp_path / "checked" / "result.json").write_text(result)
    (tmp_path / "checked" / "output.txt").write_text(text)


def test_outcome_and_output_are_posted(github, tmp_path):
    leave(tmp_path)
    place, options, body = github()
    assert place == "issues/7/comments"
    assert options[:2] == ["--method", "POST"]
    assert "`mine`: **sound**" in body
    assert "```text\nmine: sound\n```" in body
    assert "[log](https://example.org/run)" in body


def test_a_change_of_an_existing_submission_is_named(github, tmp_path):
    leave(tmp_path)
    assert "is it its owner's?" in github(status="modified")[2]
    assert "is it its owner's?" not in github()[2]
    file = "submissions/mine/checkpoints/seed-0/final/pushing.onnx"
    assert "is it its owner's?" in github(files=(file,))[2]


def test_a_second_report_replaces_the_first_and_no_other_comment(github, tmp_path):
    leave(tmp_path, "refused")
    mark = post_report.MARK
    others = [
        {"id": 1, "user": {"login": "stranger"}, "body": mark},
        {"id": 2, "user": {"login": "github-actions[bot]"}, "body": "something else"},
        {"id": 3, "user": {"login": "github-actions[bot]"}, "body": f"{mark}\nold"},
    ]
    place, options, body = github(comments=others)
    assert (place, options[:2]) == ("issues/comments/3", ["--method", "PATCH"])
    assert "**refused**" in body


@pytest.mark.parametrize(
    "files",
    [
        ["submissions/mine/run.json", ".github/workflows/submission.yml"],
        ["submissions/mine/a.onnx", "reports/results/mine/row.toml"],
        ["submissions/mine/run.json", "submissions/other/run.json"],
        [f"submissions/mine/{number}" for number in range(3000)],  # and others that are not listed
        [],
    ],
)
def test_no_report_of_a_change_that_could_have_changed_the_check(github, tmp_path, files):
    leave(tmp_path)
    _, _, body = github(files=files)
    assert "not posted" in body
    assert "sound" not in body


def test_nothing_is_posted_where_the_head_has_moved_on(github, tmp_path):
    leave(tmp_path)
    place, _, body = github(head="b" * 40)
    assert (place, body) == ("pulls", "")
    place, _, body = github(head_later="b" * 40)  # while the comment was written
    assert (place, body) == ("pulls", "")


@pytest.mark.parametrize("outcome", ["valid** @everyone [x](https://evil.example)", 3, None])
def test_an_outcome_that_does_not_exist_is_not_shown(github, tmp_path, outcome):
    leave(tmp_path, outcome)
    assert "**the check did not finish**" in github()[2]


def test_a_result_of_another_commit_or_none_is_not_shown(github, tmp_path):
    assert "**the check did not finish**" in github()[2]
    leave(tmp_path, head="b" * 40)
    assert "**the check did not finish**" in github()[2]


def test_a_text_cannot_leave_its_block(github, tmp_path):
    leave(tmp_path, text="```\n# Merged by @owner\n````\n\u202e\x1b[2J" + "x" * 100_000)
    body = github()[2]
    assert "`````text\n```\n# Merged by @owner\n````\n[2J" in body
    assert len(body) < 25_000
    assert "\x1b" not in body
    assert "\u202e" not in body


def test_a_link_is_not_followed(github, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("token")
    leave(tmp_path)
    (tmp_path / "checked" / "output.txt").unlink()
    (tmp_path / "checked" / "output.txt").symlink_to(secret)
    assert "token" not in github()[2]
