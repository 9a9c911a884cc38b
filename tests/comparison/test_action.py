"""The composite action and the example workflow, checked as far as one can without GitHub."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from minitouch_bench.comparison.gate import (
    DEFAULT_TOLERANCES,
    OTHER_TOLERANCE,
    GateSettings,
    Tolerance,
)
from tests.altered import ROOT
from tests.process_tree import git

ACTION = ROOT / ".github/actions/regress/action.yml"
WORKFLOW = ROOT / "docs/examples/regress.yml"
GATE = yaml.safe_load(ACTION.read_text())["runs"]["steps"][-1]


def gate(tmp_path, code=0, decision="no regression", **given):
    """Run the script with a stand-in command that notes its arguments."""
    command = tmp_path / "minitouch-bench"
    body = json.dumps({"decision": decision})
    command.write_text(
        f"#!/usr/bin/env bash\nprintf '%s\\n' \"$@\" > arguments\necho '{body}'\nexit {code}\n"
    )
    command.chmod(0o755)
    variables = dict.fromkeys(GATE["env"], "") | {key.upper(): text for key, text in given.items()}
    done = subprocess.run(
        ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c", GATE["run"]],
        cwd=tmp_path,
        env={
            **variables,
            "PATH": f"{tmp_path}:{Path(sys.executable).parent}:{os.environ['PATH']}",
            "GIT_CEILING_DIRECTORIES": str(tmp_path.parent),
            "RUNNER_TEMP": str(tmp_path.parent),
            "GITHUB_OUTPUT": str(tmp_path / "output"),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    return done, (tmp_path / "arguments").read_text().splitlines()


def told_junit(tmp_path):
    """Return the place of the JUnit XML that the action's output names."""
    return (tmp_path / "output").read_text().partition("\n")[0].removeprefix("junit=")


def test_the_script_passes_the_inputs_on_as_they_are(tmp_path):
    hostile = "x; touch owned $(touch owned) `touch owned`"
    done, arguments = gate(
        tmp_path,
        baseline="reports/base line",
        policy=hostile,
        metric="success",
        tolerance="5%",
        strict="true",
    )
    assert done.returncode == 0, done.stderr
    junit = told_junit(tmp_path)
    kept = Path(junit).parent
    assert kept.parent == tmp_path.parent / "minitouch-regress"
    assert arguments == [
        "regress", "--baseline", "reports/base line", "--junit", junit, "--json",
        "--metric", "success", "--tolerance", "5%", "--strict",
        "--output", f"{kept}/run", "--", hostile,
    ]  # fmt: skip
    assert not (tmp_path / "owned").exists()
    assert (tmp_path / "output").read_text() == f"junit={junit}\ndecision=no regression\n"


def test_several_runs_are_one_per_line_and_the_script_ends_as_the_gate_does(tmp_path):
    baseline, candidate = "reports/a 1\nreports/a 2\n", "reports/b 1\n\nreports/b 2"
    given = {"baseline": baseline, "candidate": candidate}
    done, arguments = gate(tmp_path, code=1, decision="regression", **given)
    assert done.returncode == 1
    assert (tmp_path / "output").read_text().endswith("\ndecision=regression\n")
    assert arguments == [
        "regress", "--baseline", "reports/a 1", "--baseline", "reports/a 2",
        "--junit", told_junit(tmp_path),
        "--json", "--candidate", "reports/b 1", "--candidate", "reports/b 2",
    ]  # fmt: skip


def test_a_committed_link_leads_nothing_out_of_the_checkout(tmp_path):
    """Neither the JUnit XML, whose place no input names, nor the run."""
    clone = tmp_path / "clone"
    clone.mkdir()
    (clone / "minitouch-regress").symlink_to(tmp_path)
    done, arguments = gate(clone, policy="p.onnx", baseline="b")
    assert done.returncode == 0, done.stderr
    for option in ("--junit", "--output"):
        written = Path(arguments[arguments.index(option) + 1])
        assert written.is_absolute()
        assert not written.is_relative_to(clone)


@pytest.fixture
def pull_request(tmp_path):
    """A shallow clone of a change that edits its own baseline, and the base commit."""
    origin, clone = tmp_path / "origin", tmp_path / "a clone"
    git(tmp_path, "init", "-q", str(origin))
    git(origin, "config", "uploadpack.allowAnySHA1InWant", "true")
    run = origin / "reports" / "base line" / "run.json"
    run.parent.mkdir(parents=True)
    for text in ("the base's", "the change's"):
        run.write_text(text)
        git(origin, "add", ".")
        git(origin, "commit", "-q", "-m", text)
    git(tmp_path, "clone", "-q", "--depth", "1", origin.as_uri(), str(clone))
    return clone, git(origin, "rev-parse", "HEAD^")


def test_a_pull_request_is_judged_by_the_baseline_of_its_base_commit(pull_request):
    clone, base = pull_request
    done, arguments = gate(clone, base=base, baseline="reports/base line", policy="p.onnx")
    assert done.returncode == 0, done.stderr
    taken = Path(arguments[arguments.index("--baseline") + 1])
    assert (taken / "run.json").read_text() == "the base's"
    own = clone / "reports" / "base line"
    for given in ({"base": base, "baseline": str(own)}, {"baseline": "reports/base line"}):
        _, arguments = gate(clone, policy="p.onnx", **given)  # the job's own; no pull request
        assert arguments[2] == given["baseline"]


@pytest.mark.parametrize("baseline", ["reports/new", "../origin/reports/base line"])
def test_a_baseline_that_the_base_commit_lacks_is_refused(pull_request, baseline):
    clone, base = pull_request
    assert refusal(clone, base=base, baseline=baseline, policy="p.onnx") == 2


def refusal(tmp_path, **given):
    """Return the script's exit code where the command was not started."""
    (tmp_path / "arguments").write_text("")
    done, arguments = gate(tmp_path, **given)
    assert arguments == []
    assert done.stdout.startswith("::error title=MiniTouch regression gate::")
    return done.returncode


def test_the_default_tolerance_of_each_metric_is_said():
    told = yaml.safe_load(ACTION.read_text())["inputs"]["tolerance"]["description"]
    for metric, tolerance in DEFAULT_TOLERANCES.items():
        assert metric in told
        assert str(tolerance) in told
    assert str(OTHER_TOLERANCE) in told


def test_the_example_uses_inputs_that_exist_and_tolerances_that_mean_something():
    steps = yaml.safe_load(WORKFLOW.read_text())["jobs"]["gate"]["steps"]
    (used,) = (step["with"] for step in steps if "actions/regress" in step["uses"])
    inputs = yaml.safe_load(ACTION.read_text())["inputs"]
    assert {name for name, told in inputs.items() if told.get("required")} <= {*used} <= {*inputs}
    GateSettings(tolerance=Tolerance.parse(used["tolerance"]))
