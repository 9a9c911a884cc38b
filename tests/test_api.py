"""The Python front door: the same runs as the command line's, for objects too."""

import math
import random
import re
import threading
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
import pytest
import torch

import minitouch_bench as mt
from minitouch_bench.agents.config import make_config
from minitouch_bench.episode import Outcome
from minitouch_bench.errors import (
    InfrastructureError,
    PolicyLoadError,
    RunDirectoryError,
    UsageError,
)
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.metrics.summary import EPISODE_COLUMNS
from minitouch_bench.shapegen.manifest import load_shape_set
from tests.altered import ROOT
from tests.process_tree import run_python
from tests.shapegen.conftest import subset

SHORT = {"suite": "smoke", "tasks": ["opening"], "episodes": 1}
"""One episode, of the task that is simulated fastest."""


class Counter:
    """Its actions depend on how often it has acted: what is left of one episode would show."""

    def __init__(self):
        self.acts = 0

    def act(self, observation):
        self.acts += 1
        action = np.zeros(4, np.float32)
        action[self.acts % 3] = 0.5
        return action


class Resets(Counter):
    def reset(self, seed, task):
        assert isinstance(seed, int)
        assert task == "opening"
        self.acts = seed % 3


class Unpicklable(Counter):
    def __init__(self):
        super().__init__()
        self.lock = threading.Lock()


@pytest.fixture(scope="module")
def counted():
    """Two episodes of an object by one worker, and the object."""
    policy = Counter()
    return mt.evaluate(policy, **{**SHORT, "episodes": 2}, workers=1), policy


def test_an_object_is_evaluated_and_its_run_is_unofficial(counted):
    run, policy = counted
    assert run.header.policy.name == "Counter"
    assert run.header.isolation == "none"
    assert not run.header.official
    assert "policy in memory, beside the simulator" in run.header.unofficial_because
    assert run.directory is None
    assert run.faults == {}
    assert repr(run) == "<Run of Counter on smoke, unofficial: opening>"
    assert "episode 1" in mt.replay(run, "opening/1").title
    assert policy.acts == 0


def test_an_object_remembers_nothing_and_workers_do_not_matter(counted):
    run, policy = counted
    again = mt.evaluate(policy, "smoke", tasks="opening", episodes=2, workers="2", name="again")
    assert again.digest == run.digest
    assert again.header.policy.name == "again"


def test_the_figures_of_a_run_are_tables_and_estimates(counted):
    run, _ = counted
    episodes = run.episodes
    assert isinstance(episodes, pd.DataFrame)
    beside = ["family", "split", "digest", "start_x", "start_y", "start_z", "start_yaw"]
    beside += ["target_x", "target_y", "end_effector_x", "end_effector_y", "end_effector_z"]
    assert list(episodes.columns) == [*EPISODE_COLUMNS, *beside]
    assert list(episodes["task"]) == ["opening"] * 2
    assert run.exploration_episodes.empty
    table = run.table4()
    assert table.loc["success", ("opening", "value")] == run["opening"].success.value
    assert np.isnan(table.loc["exploration", ("opening", "low")])
    steps = run["opening"].episode_steps
    assert steps.low <= steps.value <= steps.high
    assert steps.value == episodes["steps"].mean()
    assert "success" in dir(run["opening"])
    assert sum(run["opening"].outcomes.values()) == 2
    assert all("<table" in one._repr_html_() for one in (run, run["opening"]))


def test_what_a_run_does_not_have_is_named(counted):
    run, _ = counted
    with pytest.raises(KeyError, match="no task 'pushing'; it has opening"):
        run["pushing"]
    with pytest.raises(AttributeError, match="no metric 'speed' here; there are success"):
        run["opening"].speed  # noqa: B018


def test_the_caller_s_generators_and_threads_stay_as_they_are():
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    before = states()
    try:
        assert mt.evaluate(Resets(), **SHORT, workers=1).faults == {}
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)
    assert states() == before


def states():
    old = np.random.get_state()  # noqa: NPY002 - what a training may use
    return random.getstate(), old[1].tolist(), torch.get_rng_state().tolist()


def test_a_run_with_a_directory_is_loaded_and_compared(tmp_path, counted):
    run = mt.evaluate("scripted", **SHORT, workers=1, output=tmp_path / "run")
    loaded = mt.load_run(tmp_path / "run")
    assert loaded == run
    assert loaded["opening"].success.value == 1.0
    comparison = mt.compare(run, str(tmp_path / "run"), output=tmp_path / "page")
    assert comparison.pairs[0].identical
    assert {path.name for path in (tmp_path / "page").iterdir()} == {
        "comparison.json", "comparison.md",
    }  # fmt: skip
    with pytest.raises(UsageError, match="not of the same episodes"):
        mt.compare(run, counted[0])
    with pytest.raises(RunDirectoryError, match="resume"):
        mt.evaluate("scripted", **SHORT, output=tmp_path / "run")


@pytest.mark.parametrize(
    ("policy", "reason"),
    [
        (42, "int is not a policy: .* an object with act"),
        (Counter, "class"),
        (Unpicklable(), "Unpicklable cannot be copied for each episode"),
        ("gone.pt", "does not exist"),
        ("\udcff.pt", "UTF-8"),
    ],
)
def test_what_is_no_policy_is_refused(policy, reason):
    with pytest.raises(PolicyLoadError, match=reason):
        mt.evaluate(policy, **SHORT)


def make_by_gymnasium(task, **options):
    return gymnasium.make("MiniTouch/Pushing-v1", **options)


@pytest.mark.parametrize(
    ("call", "options", "word"),
    [
        (mt.evaluate, {"act_timeout": "5"}, "act_timeout"),
        (mt.evaluate, {"act_timeout": 1e300}, "86400"),
        (mt.evaluate, {"callbacks": Callbacks}, "callbacks"),
        (mt.evaluate, {"stop_after": math.nan}, "stop_after"),
        (mt.evaluate, {"episodes": True}, "episodes"),
        (mt.evaluate, {"tasks": ["pushing", 5]}, "tasks"),
        (mt.evaluate, {"tasks": ["flying"]}, "flying"),
        (mt.evaluate, {"workers": 0}, "number"),
        (mt.evaluate, {"output": "here", "video": -1}, "0 or more"),
        (mt.evaluate, {"progress": True, "callbacks": Callbacks()}, "one of them"),
        (mt.make, {"max_steps": 300}, "max_steps"),
        (mt.make, {"objects": [3]}, "objects"),
        (mt.train, {"config": 5}, "config"),
        (mt.train, {"progress": True, "callbacks": Callbacks()}, "one of them"),
        (make_by_gymnasium, {"max_steps": 300}, "max_steps"),
        (lambda _: mt.make("flying"), {}, "no task 'flying'"),
        (lambda _, **given: Callbacks(**given), {"episode": 5}, "episode"),
        (lambda _, **given: mt.load_run(**given), {"path": None}, "path"),
        (lambda _, **given: mt.compare("a", **given), {"output": 5}, "output"),
        (mt.replay, {"episode": 5}, "episode"),
        (mt.export, {"path": "a.pt2", "task": 5}, "task"),
    ],
)
def test_an_argument_that_there_is_not_or_cannot_be_is_refused(
    call, options, word, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=word):
        call("pushing", **options)


def test_numbers_of_numpy_and_one_name_of_episodes_are_taken():
    options = {"seed": np.int64(3), "act_timeout": np.float32(2), "video": np.uint8(0),
               "resume": np.bool_(False)}  # fmt: skip
    run = mt.evaluate("zero", "smoke", episodes_from="opening/3", workers=np.int64(1), **options)
    assert list(run.episodes["index"]) == [3]
    assert (run.plan.seed, run.plan.limits.act_timeout_s) == (3, 2.0)
    settings = {"seed": np.int64(3), "task_phase": {"steps": np.int64(5)}}
    config = make_config("opening", settings=settings)
    assert (config.seed, config.task_phase.steps) == (3, 5)


def test_a_path_in_the_user_s_directory_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    run = mt.evaluate("zero", "smoke", episodes_from="opening/3", output="~/run")
    assert run == mt.load_run("~/run") == mt.load_run(tmp_path / "run")
    assert mt.compare("~/run", run).pairs[0].identical
    assert mt.replay("~/run", "opening/3")
    with pytest.raises(PolicyLoadError, match=re.escape(str(tmp_path))):
        mt.evaluate("~/none.pt", "smoke")


def test_a_set_of_objects_can_be_a_path(tmp_path, monkeypatch):
    folder = subset(tmp_path / "train", 3)
    monkeypatch.chdir(tmp_path)
    names = [shape.name for shape in load_shape_set(folder).shapes]
    run = mt.evaluate("zero", "smoke", tasks="playing", episodes=1, objects=folder)
    assert list(run.episodes["shape"]) == names[:1]
    environment = mt.make("playing", objects=Path("train"))  # as a text a split of our own
    assert list(environment.unwrapped._pool.names) == names
    environment.close()


def test_an_unknown_name_is_an_error_that_names_it():
    with pytest.raises(AttributeError, match="no attribute 'evaluat'"):
        mt.evaluat  # noqa: B018


@pytest.mark.slow
def test_the_page_for_python_runs_from_top_to_bottom(tmp_path):
    page = (ROOT / "docs" / "how-to" / "python.md").read_text(encoding="utf-8")
    (tmp_path / "page.py").write_text(
        "\n".join(re.findall(r"^```python\n(.*?)^```", page, re.M | re.S))
    )
    done = run_python("-W", "error", "page.py", cwd=tmp_path)
    assert "Episodes to resolve" in done.stdout
    assert (tmp_path / "reports" / "first" / "report.html").exists()


def test_an_error_of_ours_that_a_policy_raises_is_its_fault():
    class Planner(Counter):
        def act(self, observation):
            return mt.make("flying")

    run = mt.evaluate(Planner(), **SHORT)
    assert {row.outcome for row in run.rows} == {Outcome.POLICY_FAULT}


def test_a_view_that_cannot_be_written_is_resumed(tmp_path, monkeypatch):
    def full(*_):
        raise RunDirectoryError("report.html cannot be written: No space left on device")

    monkeypatch.setattr("minitouch_bench.api.write_views", full)
    with pytest.raises(InfrastructureError, match="--resume continues"):
        mt.evaluate("zero", **SHORT, output=tmp_path / "run")
    monkeypatch.undo()
    mt.evaluate("zero", **SHORT, output=tmp_path / "run", resume=True)
    assert (tmp_path / "run" / "report.html").exists()


def test_progress_is_shown_where_it_is_asked_for_and_nothing_where_nobody_watches(capsys):
    mt.evaluate("zero", **SHORT)
    assert capsys.readouterr().err == ""
    mt.evaluate("zero", **SHORT, progress=True)
    assert "1/1" in capsys.readouterr().err
