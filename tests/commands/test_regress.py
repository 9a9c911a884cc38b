import hashlib
import json
import shlex
from xml.etree import ElementTree

import pytest

from minitouch_bench.episode import PolicyIdentity, Role
from minitouch_bench.files import ACTIONS_FILE
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.runs.run import parse_run, read_run, run_digest
from tests.commands.command import run, succeed
from tests.leaderboard.playing import write_policy
from tests.reporting.synthetic import played
from tests.reporting.synthetic import write as write_run


def write(directory, episodes=4, skill=0.8):
    """Write a run of so many episodes of each task, and what can be replayed."""
    name = directory.name
    policy = PolicyIdentity(name, name, "native", hashlib.sha256(name.encode()).hexdigest())
    plan = make_plan("table4", episodes=episodes)
    write_run(played(plan, {Role.FINAL: policy}, skill, 0), directory)
    (directory / ACTIONS_FILE).touch()


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    directory = tmp_path_factory.mktemp("runs")
    for name, skill in {"good": 0.9, "bad": 0.2, "worse": 0.25, "close": 0.85}.items():
        write(directory / name, 60, skill)
    write(directory / "few")
    write(directory / "few-good", skill=1.0)
    return directory


def gate(runs, candidate, *options):
    return run("regress", "--baseline", "good", "--candidate", candidate, *options, directory=runs)


def edited(runs, name, change):
    """A copy of the good run, called ``name``, whose document ``change`` has edited."""
    document = json.loads((runs / "good" / "run.json").read_text())
    change(document)
    (runs / name).mkdir(exist_ok=True)
    (runs / name / "run.json").write_text(json.dumps(document))  # its layout does not matter
    return name


def test_a_regression_exits_1_and_writes_all_it_is_asked_for(runs, tmp_path):
    files = ("--junit", tmp_path / "out" / "gate.xml", "--summary", tmp_path / "summary.md")
    done = gate(runs, "bad", *files)
    assert done.code == 1, done.err
    answer, following = done.out.strip().splitlines()[-2:]
    assert answer.startswith("regression: mean success ")
    assert following.startswith("next: minitouch-bench replay good ")
    suite = ElementTree.parse(tmp_path / "out" / "gate.xml").getroot().find("testsuite")
    assert len(suite.findall("testcase")) > 6
    assert int(suite.attrib["failures"]) >= 3
    summary = (tmp_path / "summary.md").read_text()
    assert summary.startswith("## ❌ minitouch-bench regression: ")


def test_several_runs_on_each_side_judge_the_method(runs, tmp_path):
    file = tmp_path / "gate.xml"
    done = gate(runs, "bad", "--baseline", "close", "--candidate", "worse", "--junit", file)
    assert done.code == 1, done.err
    answer, following = done.out.strip().splitlines()[-2:]
    assert answer.startswith("regression: mean success ")
    assert "in 4 training seeds" in answer
    assert following == "next: minitouch-bench report good close bad worse"
    assert int(ElementTree.parse(file).getroot().attrib["failures"]) >= 1


def test_the_summary_of_a_github_step_is_added_to(runs, tmp_path, monkeypatch):
    page = tmp_path / "step.md"
    page.write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(page))
    assert gate(runs, "good").code == 0
    assert gate(runs, "bad").code == 1
    text = page.read_text()
    assert text.startswith("before\n## ✅ minitouch-bench no regression: ")
    assert text.count("\n## ") == 2
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(runs / "good"))  # of another machine
    assert gate(runs, "bad").code == 1
    assert gate(runs, "bad", "--summary", tmp_path).code == 6


def test_not_enough_episodes_are_never_called_a_pass_and_fail_if_worse_beyond_the_tolerance(runs):
    command = ("regress", "--baseline", "few-good", "--candidate", "few", "--alpha", "0.001")
    done = run(*command, "--json", directory=runs)
    assert (done.code, json.loads(done.out)["decision"]) == (5, "not enough episodes")
    done = succeed(*command, "--lenient", directory=runs)
    assert "not enough episodes: mean success" in done.out
    assert "warning" in done.err
    assert "warning" not in gate(runs, "good", "--lenient").err


def test_a_task_whose_rules_changed_is_refused_by_name(runs):
    def change(document):
        header = document["header"]
        header["task_digests"]["opening"] = "0" * 64
        saved = parse_run(json.dumps(document).encode(), "other")
        document["digest"] = run_digest(saved.header, saved.rows, saved.exploration_rows)

    baseline = edited(runs, "other-rules", change)
    for candidate in (("--candidate", "good"), ("zero",)):
        done = run("regress", "--baseline", baseline, *candidate, directory=runs)
        done.refused(2, "other-rules", "rules of opening", "make the run again")
    assert not (runs / "reports").exists()


# The digest covers the first of them, not the second.
@pytest.mark.parametrize(("field", "value"), [("outcome", "left_workspace"), ("touch_steps", 1)])
def test_a_run_that_was_edited_is_refused_on_either_side(runs, field, value):
    one = edited(runs, f"edited-{field}", lambda d: d["episodes"][0].update({field: value}))
    for baseline, candidate in ((one, "good"), ("good", one)):
        pair = ("--baseline", baseline, "--candidate", candidate)
        run("regress", *pair, directory=runs).refused(6, "was edited")


GOOD = ("--baseline", "good")
REFUSED = [
    (GOOD, 2, "POLICY"),
    (("zero", *GOOD, "--candidate", "bad"), 2, "POLICY"),
    ((*GOOD, "--candidate", "bad", "--workers", "1"), 2, "need a POLICY"),
    ((*GOOD, "--candidate", "few"), 2, "same episodes"),
    (("--baseline", "gone", "--candidate", "good"), 6, "gone"),
    ((*GOOD, "--candidate", "bad", "--resume"), 2, "--resume"),
]


@pytest.mark.parametrize(("options", "code", "word"), REFUSED)
def test_mistakes_end_in_two_lines(runs, options, code, word):
    run("regress", *options, directory=runs).refused(code, word)


# With a policy, in the simulator

BASE = ("--tasks", "opening", "--episodes", "1", "--output", "base")


def test_a_policy_is_played_under_the_baseline_s_conditions(tmp_path):
    conditions = ("--without", "vision", "--perturb", "mass=2")
    succeed("evaluate", "random", *BASE, *conditions, directory=tmp_path)
    succeed("regress", "random", "--baseline", "base", "--output", "new", directory=tmp_path)
    plan = json.loads((tmp_path / "new" / "run.json").read_text())["header"]["plan"]
    assert plan["conditions"]["without"] == ["vision"]
    assert plan["conditions"]["mass"] == [2.0, 2.0]


def test_a_policy_that_is_clearly_worse_is_a_regression_whose_commands_work(tmp_path):
    ten = ("--tasks", "pushing,opening", "--episodes", "5")
    succeed("evaluate", "scripted", *ten, "--output", "base", directory=tmp_path)
    command = ("regress", "zero", "--baseline", "base", "--output", "zero")
    done = run(*command, "--json", directory=tmp_path)
    document = json.loads(done.out)
    assert (done.code, document["decision"]) == (1, "regression")
    assert len(document["changes"]) == 10
    for command_line in (document["next_command"], document["changes"][-1]["replay"]):
        program, verb, directory, key, *beside = shlex.split(command_line)
        assert (program, verb) == ("minitouch-bench", "replay")
        spec, row = read_run(tmp_path / directory).find(key)
        assert spec.key == f"{row.task}/{row.index}"
        assert beside == ["--beside", "zero"]
    run(*command, directory=tmp_path).refused(6, "--resume", "--fresh")
    onto = (*command[:4], "--output", "./base", "--fresh")
    run(*onto, directory=tmp_path).refused(2, "holds the baseline")
    again = run(*command, "--resume", "--json", directory=tmp_path)
    assert json.loads(again.out) == document


def test_exploration_episodes_of_a_baseline_are_left_out(tmp_path):
    write_policy(tmp_path / "explored.safetensors")
    run("evaluate", "random", "--exploration", "explored.safetensors", *BASE, directory=tmp_path)
    done = succeed("regress", "random", "--baseline", "base", "--output", "new", directory=tmp_path)
    assert "left out" in done.err
    assert "every episode is the same to the last bit" in done.out
    assert (tmp_path / "new" / "report.html").exists()


def test_a_finished_run_of_a_factory_is_played_again(tmp_path):
    policy = ("misbehaved:Still", "--trust")
    succeed("evaluate", *policy, *BASE, directory=tmp_path)
    command = ("regress", *policy, "--baseline", "base", "--output", "again")
    succeed(*command, directory=tmp_path)
    run(*command, "--resume", directory=tmp_path).refused(2, "no digest", "--fresh")
    succeed(*command, "--fresh", directory=tmp_path)
