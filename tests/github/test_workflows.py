"""The workflows, checked as far as one can without GitHub: who may do what, and what they call."""

import re

import check_version
import pytest
import yaml

from tests.altered import ROOT

FOLDER = ROOT / ".github" / "workflows"
FILES = sorted(FOLDER.glob("*.yml"))
EXAMPLE = ROOT / "docs" / "examples" / "regress.yml"
ACTION_FILE = ROOT / ".github" / "actions" / "regress" / "action.yml"
OF_STRANGERS = {"image", "site", "submission", "tests"}
"""They run on pull requests, also from forks."""

WRITING = {
    "release/publish": {"id-token": "write", "attestations": "write"},
    "site/deploy": {"pages": "write", "id-token": "write"},
    "submission-report/comment": {"contents": "read", "actions": "read", "pull-requests": "write"},
}
"""Every job that may write, and all that it may."""

OURS = "uses: OWNER/minitouch-bench/.github/actions/regress@COMMIT # v1.0.0\n"
"""The gate in the example; a user who copies it replaces COMMIT by a commit of the project."""

ACTION = re.compile(
    r"((?:actions/|pypa/gh-action-)[a-z-]+)@([0-9a-f]{40} # v[0-9]+\.[0-9]+\.[0-9]+)"
)


@pytest.mark.parametrize("name", [file.stem for file in FILES])
def test_no_strangers_code_meets_a_secret_or_a_token_that_writes(name):
    document = yaml.safe_load((FOLDER / f"{name}.yml").read_text())
    for key, job in document["jobs"].items():
        assert job.get("permissions") == WRITING.get(f"{name}/{key}"), key
        assert job["timeout-minutes"] <= 350, key
        if "permissions" in job:  # it checks out no pull request and runs no policy
            for step in job["steps"]:
                assert "ref" not in step.get("with", {})
                assert not re.search("make|minitouch", step.get("run", "")), key
    on = document[True]  # YAML 1.1 reads the key "on" as true
    assert document["permissions"] in ({}, {"contents": "read"})  # a job that needs more says so
    assert "pull_request_target" not in on
    assert "secrets." not in (FOLDER / f"{name}.yml").read_text()
    assert ("pull_request" in on) == (name in OF_STRANGERS)
    if name in OF_STRANGERS:
        for key, job in document["jobs"].items():
            if "permissions" in job:
                assert job["if"].startswith("github.event_name != 'pull_request' && "), key


@pytest.mark.parametrize("file", [*FILES, ACTION_FILE, EXAMPLE], ids=lambda file: file.stem)
def test_steps_use_no_credentials_and_scripts_no_expressions(file):
    document = yaml.safe_load(file.read_text())
    jobs = document["jobs"].values() if "jobs" in document else [document["runs"]]
    for step in (step for job in jobs for step in job["steps"]):
        if step.get("uses", "").startswith("actions/checkout@"):
            assert step["with"]["persist-credentials"] is False
        assert "${{" not in step.get("run", "")


def test_actions_are_known_ones_pinned_to_one_commit_each():
    pins = {}
    for file in (*(ROOT / ".github").rglob("*.yml"), EXAMPLE):
        for used in re.findall(r"uses: (.*)", file.read_text().replace(OURS, "")):
            action = ACTION.fullmatch(used)
            assert action, f"{file.name}: {used}"
            assert pins.setdefault(*action.groups()) == action[2], file.name


def test_a_release_needs_the_version_s_tag_and_the_account_that_publishes(
    monkeypatch, tmp_path, capsys
):
    text = (ROOT / "pyproject.toml").read_text()
    version = re.search(r'^version = "(.*)"$', text, re.MULTILINE)[1]

    monkeypatch.setattr(check_version, "ROOT", tmp_path)
    for tag, account, code in (
        (f"v{version}", "someone", 0),
        ("v99.0.0", "someone", 1),
        (f"v{version}", "OWNER", 1),
    ):
        placed = re.sub(r"(Repository = .*github.com/)[^/]+", rf"\g<1>{account}", text)
        (tmp_path / "pyproject.toml").write_text(placed)
        monkeypatch.setattr(check_version.sys, "argv", ["check_version.py", tag])
        assert check_version.main() == code
    assert "OWNER is not set" in capsys.readouterr().err
