"""The main job: what it leaves behind, and how it ends on every kind of bad input."""

import csv
import json
import os
import shutil
import time
from signal import SIGINT, SIGTERM

import numpy as np
import pytest

from minitouch_bench.files import JOURNAL_FILE, RUN_FILES, lock_directory
from minitouch_bench.runs.run import read_run
from tests.archives import zipped
from tests.commands.command import finish, run, run_installed, same_results, start, wait_for_records
from tests.commands.conftest import SCRIPTED

ONE = ("--tasks", "pushing", "--episodes", "1", "--workers", "1")


def rows(directory):
    with (directory / "episodes.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_run_leaves_its_files_and_shows_its_table(scripted):
    done, directory = scripted
    assert done.code == 0, done.err
    assert set(os.listdir(directory)) == {*RUN_FILES} - {JOURNAL_FILE}
    assert "Success" in done.out
    assert "4/4" in done.err
    assert "report.html" in done.err
    assert [row["outcome"] for row in rows(directory)] == ["success"] * 4
    document = json.loads((directory / "run.json").read_text())
    assert "reads the simulator's state" in (directory / "run.json").read_text()
    assert "2 of 100 episodes per task" in json.dumps(document)


@pytest.mark.slow
def test_the_first_episodes_are_filmed_and_shown_if_asked_for(tmp_path):
    done = run(*SCRIPTED, "--output", "run", "--video", 1, "--replays", 1, directory=tmp_path)
    assert "filming 2 episodes" in done.err
    assert sorted(os.listdir(tmp_path / "run" / "videos")) == ["opening-0.mp4", "pushing-0.mp4"]
    assert sorted(os.listdir(tmp_path / "run" / "replays")) == ["opening-0.html", "pushing-0.html"]
    page = (tmp_path / "run" / "report.html").read_text()
    assert "videos/pushing-0.mp4" in page
    assert "replays/pushing-0.html" in page


@pytest.fixture(scope="module")
def chosen(tmp_path_factory):
    """The first episode of Opening and the second of Pushing alone."""
    directory = tmp_path_factory.mktemp("chosen")
    which = ("--episodes-from", "opening/0", "--episodes-from", "pushing/1")
    done = run("evaluate", "scripted", *which, "--output", "run", directory=directory)
    return done, directory / "run", which


def test_chosen_episodes_hold_the_bits_of_the_whole_run(scripted, chosen):
    done, directory, _ = chosen
    assert done.code == 0, done.err
    assert "unofficial: episodes pushing/1, opening/0 only" in done.out
    whole = [row for row in rows(scripted[1]) if (row["task"], row["index"]) in TWO]
    assert rows(directory) == whole
    with np.load(directory / "actions.npz") as own, np.load(scripted[1] / "actions.npz") as other:
        assert {*own.files} == {"pushing/1", "opening/0"}
        assert all(np.array_equal(own[key], other[key]) for key in own.files)


TWO = {("pushing", "1"), ("opening", "0")}


def test_a_run_of_chosen_episodes_is_verified_replayed_reported_and_resumed(chosen, tmp_path):
    _, directory, which = chosen
    assert run("verify", directory, directory=tmp_path).code == 0
    assert run("replay", directory, "pushing/1", directory=tmp_path).code == 0
    gone = run("replay", directory, "pushing/0", directory=tmp_path)
    gone.refused(2, "no episode 'pushing/0'; it has pushing/1, opening/0")
    copy = shutil.copytree(directory, tmp_path / "copy")
    assert run("report", copy, directory=tmp_path).code == 0
    page = (copy / "report.html").read_text()
    assert "--episodes-from pushing/1 --episodes-from opening/0" in page
    assert "episodes per task" not in page
    again = ("evaluate", "scripted", "--output", copy, "--resume")
    assert run(*again, *which, directory=tmp_path).code == 0
    run(*again, *which[:2], directory=tmp_path).refused(6, "chosen: pushing/1, opening/0")


def test_chosen_episodes_that_do_not_exist(tmp_path):
    wrong = ("evaluate", "zero", "--episodes-from")
    run(*wrong, "pushing/100", directory=tmp_path).refused(2, "pushing/0 to pushing/99")
    run(*wrong, "pushing/1", "--episodes", 2, directory=tmp_path).refused(2, "leave out")


@pytest.mark.parametrize(
    ("policy", "word"),
    [
        ("gone.pt", "does not exist"),
        ("notes.pt", "notes.pt"),
        ("cut.zip", "cut.zip"),
        ("misbehaved:Still", "--trust"),
    ],
)
def test_a_policy_that_cannot_be_used_is_refused_and_makes_no_directory(tmp_path, policy, word):
    (tmp_path / "notes.pt").write_text("dear diary\n")
    (tmp_path / "cut.zip").write_bytes(zipped({"data": "{}" * 1000})[:-40])
    run("evaluate", policy, directory=tmp_path).refused(3, word)
    assert not (tmp_path / "reports").exists()


def test_faults_are_counted_and_named_and_the_run_finishes(tmp_path):
    options = ("--trust", "--tasks", "pushing,opening", "--episodes", 1, "--act-timeout", 7.5)
    policy = "misbehaved:FaultInPushing"
    done = run("evaluate", policy, *options, "--output", "run", directory=tmp_path)
    assert done.code == 4
    assert "Traceback" not in done.err
    assert [row["outcome"] for row in rows(tmp_path / "run")] == ["policy_fault", "step_limit"]
    played = read_run(tmp_path / "run")
    assert played.faults.keys() == {"pushing/0"}
    assert played.rows[0].steps == len(played.actions["pushing/0"]) == 2
    assert {row["success"] for row in rows(tmp_path / "run")} == {"false"}
    for file in ("run.json", "report.html"):
        assert "NaN" in (tmp_path / "run" / file).read_text()
    assert '"act_timeout_s": 7.5' in (tmp_path / "run" / "run.json").read_text()


@pytest.mark.parametrize("isolation", ["none", "process"])
def test_a_policy_that_ends_its_program_is_at_fault(tmp_path, isolation):
    options = (*ONE, "--trust", "--isolation", isolation, "--output", "run")
    done = run_installed("evaluate", "misbehaved:Quits", *options, directory=tmp_path)
    assert done.code == 4, done.err
    assert read_run(tmp_path / "run").faults.keys() == {"pushing/0"}
    unloaded = run_installed("evaluate", "misbehaved:quit_at_once", *options, directory=tmp_path)
    unloaded.refused(3, "quit_at_once")


def test_what_a_policy_prints_is_apart_from_the_results(tmp_path):
    options = (*ONE, "--trust", "--isolation", "none", "--output", "run", "--json")
    done = run_installed("evaluate", "misbehaved:Talks", *options, directory=tmp_path)
    assert json.loads(done.out) == json.loads((tmp_path / "run" / "run.json").read_text())
    assert {"made", "begun", "acting", "ended"} <= {*done.err.split()}


def test_a_policy_that_is_killed_with_much_memory_is_not_tried_again(tmp_path):
    options = ("--trust", "--isolation", "process", *ONE, "--output", "run")
    done = run("evaluate", "misbehaved:Greedy", *options, directory=tmp_path)
    assert done.code == 5
    assert (
        "episode pushing/0: the policy's process was killed by SIGKILL while it used 4" in done.err
    )
    assert "failed 3 times" not in done.err
    assert "--resume" in done.err


@pytest.mark.parametrize(
    ("options", "code", "word"),
    [
        (("--tasks", "flying"), 2, "pick-up"),
        (("--workers", "many"), 2, "--workers"),
        (("--name", " "), 2, "--name is empty"),
        (("--isolation", "none"), 2, "--trust"),
        (("--tasks", "playing", "--exploration", "gone.pt"), 2, "task with a goal"),
        (("--exploration", "random"), 2, "leave it out"),
        (("--exploration", "open-loop"), 2, "leave it out"),
        (("--exploration", "gone.pt"), 3, "gone.pt"),
        (("--output", "file/run"), 6, "cannot be written"),
        (("--output", "busy"), 6, "in use"),
    ],
)
def test_a_mistake_is_refused_and_makes_no_directory(tmp_path, options, code, word):
    (tmp_path / "file").write_text("no directory")
    with lock_directory(tmp_path / "busy"):
        run("evaluate", "zero", *ONE[2:], *options, directory=tmp_path).refused(code, word)
    assert set(os.listdir(tmp_path)) == {"busy", "file"}


def test_a_directory_that_holds_a_run_is_not_touched(scripted):
    _, directory = scripted
    before = {path.name: path.read_bytes() for path in directory.iterdir()}
    again = run(*SCRIPTED, "--output", directory, directory=directory.parent)
    again.refused(6, "this run of scripted on table4", "--resume", "--fresh")
    for resume in ((), ("--resume",)):
        other = ("evaluate", "zero", *ONE, "--output", directory, *resume)
        other = run(*other, directory=directory)
        other.refused(6, "another run, of scripted on table4", "there, zero asked for", "--fresh")
        assert "--resume" not in other.err
    assert {path.name: path.read_bytes() for path in directory.iterdir()} == before


@pytest.mark.parametrize(("stop", "episodes"), [(SIGINT, 0), (SIGINT, 1), (SIGTERM, 1)])
def test_a_stopped_run_is_resumed_with_the_same_result(scripted, tmp_path, stop, episodes):
    process = start(*SCRIPTED, "--workers", 1, "--output", "run", directory=tmp_path)
    wait_for_records(tmp_path / "run", episodes, process)
    began = time.monotonic()
    os.killpg(process.pid, stop)
    broken = finish(process)
    assert time.monotonic() - began < 30.0
    assert broken.code == 130
    assert broken.out == ""
    assert "Traceback" not in broken.err
    assert "--resume" in broken.err or not episodes
    done = run(*SCRIPTED, "--output", "run", "--resume", "--json", directory=tmp_path)
    assert done.code == 0
    assert json.loads(done.out) == json.loads((tmp_path / "run" / "run.json").read_text())
    same_results(tmp_path / "run", scripted[1])
