"""Runs of single tasks, joined: what one evaluation of all tasks would have written."""

from dataclasses import replace

import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.runs.joining import join_runs
from minitouch_bench.runs.run import read_run, run_json
from minitouch_bench.verification.checks import check_run
from tests.leaderboard.synthetic import official_run, task_run, write_official
from tests.reporting.synthetic import measured


def written(run, place):
    write_official(run, place)
    return read_run(place)


@pytest.fixture(scope="module")
def whole():
    return official_run(exploration=True, faults=3)


@pytest.fixture(scope="module")
def parts(whole, tmp_path_factory):
    root = tmp_path_factory.mktemp("parts")
    return {task: written(task_run(whole, task), root / task) for task in TASK_NAMES}


def join(runs, run, place):
    header = run.header
    join_runs([*runs], header.policy, header.exploration, place)
    return read_run(place)


def test_single_tasks_make_the_run_of_all(whole, parts, tmp_path):
    in_another_order = [parts[task] for task in reversed(TASK_NAMES)]
    joined = join(in_another_order, whole, tmp_path)
    expected = measured(whole, tmp_path.name)
    assert joined.environment.wall_s == 4 * expected.environment.wall_s
    assert run_json(replace(joined, environment=expected.environment)) == run_json(expected)
    assert [*check_run(joined, recompute=True)] == []
    alone = written(whole, tmp_path / "alone")
    assert [*joined.actions] == [*alone.actions]
    assert all((joined.actions[key] == alone.actions[key]).all() for key in alone.actions)


def test_gaps_on_novel_shapes_are_kept(tmp_path):
    whole = official_run("novel-shapes")
    runs = [written(task_run(whole, task), tmp_path / task) for task in whole.header.plan.tasks]
    joined = join(runs, whole, tmp_path)
    assert joined.summary == measured(whole, tmp_path.name).summary


def test_some_tasks_are_an_unofficial_run(whole, parts, tmp_path):
    joined = join([parts["opening"], parts["pushing"]], whole, tmp_path)
    assert joined.plan.tasks == ("pushing", "opening")
    assert joined.header.unofficial_because == ("tasks pushing, opening only",)


def test_runs_that_do_not_belong_together_are_refused(whole, parts, tmp_path):
    pushing, opening = parts["pushing"], parts["opening"]
    with pytest.raises(UsageError, match="the same task"):
        join([pushing, pushing], whole, tmp_path)
    other = replace(opening, header=replace(opening.header, plan=replace(opening.plan, seed=1)))
    with pytest.raises(UsageError, match="different plans"):
        join([pushing, other], whole, tmp_path)
    rules = replace(opening.header, task_digests={"opening": "0" * 64})
    with pytest.raises(UsageError, match="other rules of opening"):
        join([pushing, replace(opening, header=rules)], whole, tmp_path)
    edited = replace(opening, episodes=opening.episodes[::-1])
    with pytest.raises(UsageError, match="was edited"):
        join([pushing, edited], whole, tmp_path)
    assert not [*tmp_path.iterdir()]


def test_facts_of_several_machines_are_not_those_of_the_first(whole, parts, tmp_path):
    other = replace(
        parts["opening"].environment,
        packages={"minitouch-bench": "0.2.0", "pybullet": "3.2.7"},
        started="2024-01-01T00:00:00+00:00",
    )
    runs = [parts["pushing"], replace(parts["opening"], environment=other)]
    found = join(runs, whole, tmp_path).environment
    assert found.packages == {"minitouch-bench": "several", "pybullet": "3.2.7"}
    assert found.started == other.started
