"""The comment on a pull request: what of a stranger's files and names can get into it."""

import json
from types import SimpleNamespace

import post_report
import pytest

HEAD, OTHER = "a" * 40, "b" * 40
FILE = "submissions/mine/submission.toml"
ENVIRONMENT = {
    "GITHUB_REPOSITORY": "owner/bench", "HEAD_SHA": HEAD, "HEAD_OWNER": "stranger",
    "HEAD_BRANCH": "patch", "RUN_URL": "https://example.org/run",
}  # fmt: skip


@pytest.fixture
def github(tmp_path, monkeypatch):
    """A function that posts to a stand-in of ``gh``, and returns its last call."""
    for name, value in {**ENVIRONMENT, "CHECKED": str(tmp_path / "checked")}.items():
        monkeypatch.setenv(name, value)
    (tmp_path / "checked").mkdir()

    def post(files=(FILE,), heads=(HEAD, HEAD), comments=(), status="added"):
        pulls = [{"number": 7, "head": {"sha": one}, "base": {"ref": "main"}} for one in heads]
        calls = []

        def run(command, **options):
            given = options["input"]
            place = command[2].removeprefix("repos/owner/bench/").partition("?")[0]
            calls.append((place, command[3:], json.loads(given)["body"] if given else ""))
            answers = {
                "pulls/7/files": [[{"filename": name, "status": status} for name in files]],
                "issues/7/comments": [[*comments]],
            }
            answer = [pulls.pop(0)] if place == "pulls" else answers.get(place, {})
            return SimpleNamespace(stdout=json.dumps(answer))

        monkeypatch.setattr(post_report.subprocess, "run", run)
        assert post_report.main() == 0
        return calls[-1]

    return post


def leave(tmp_path, outcome="sound", text="mine: sound\n", head=HEAD):
    """Write what the checking job leaves."""
    result = json.dumps({"head": head, "outcomes": {"mine": outcome}})
    (tmp_path / "checked" / "result.json").write_text(result)
    (tmp_path / "checked" / "output.txt").write_text(text)


def test_outcome_and_output_are_posted(github, tmp_path):
    leave(tmp_path)
    place, options, body = github()
    assert (place, options[:2]) == ("issues/7/comments", ["--method", "POST"])
    for text in (
        "`mine`: **sound**",
        "```text\nmine: sound\n```",
        "[log](https://example.org/run)",
    ):
        assert text in body
    assert "is it its owner's?" not in body
    for change in ({"status": "modified"}, {"files": ("submissions/mine/checkpoints/a.onnx",)}):
        assert "is it its owner's?" in github(**change)[2]


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


@pytest.mark.parametrize("heads", [(OTHER, OTHER), (HEAD, OTHER)])
def test_nothing_is_posted_where_the_head_has_moved_on(github, tmp_path, heads):
    leave(tmp_path)
    place, _, body = github(heads=heads)
    assert (place, body) == ("pulls", "")


@pytest.mark.parametrize(
    "result", [None, {"outcome": "valid** @everyone"}, {"outcome": 3}, {"head": OTHER}]
)
def test_an_unknown_outcome_one_of_another_commit_or_none_is_not_shown(github, tmp_path, result):
    if result:
        leave(tmp_path, **result)
    assert "**the check did not finish**" in github()[2]


def test_a_text_cannot_leave_its_block(github, tmp_path):
    leave(tmp_path, text="```\n# Merged by @owner\n````\n\u202e\x1b[2J" + "x" * 100_000)
    body = github()[2]
    assert "`````text\n```\n# Merged by @owner\n````\n[2J" in body
    assert len(body) < 25_000
    assert not {"\x1b", "\u202e"} & {*body}


def test_a_link_is_not_followed(github, tmp_path):
    leave(tmp_path)
    output = tmp_path / "checked" / "output.txt"
    output.rename(tmp_path / "secret")
    output.symlink_to(tmp_path / "secret")
    assert "mine: sound" not in github()[2]
