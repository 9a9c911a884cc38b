"""The main job: what it leaves behind, and how it ends on every kind of bad input."""

import csv
import json
import os
import time
from signal import SIGINT, SIGTERM

import numpy as np
import pytest

from minitouch_bench.files import JOURNAL_FILE, RUN_FILES, lock_directory
from minitouch_bench.runs.run import read_run
from tests.archives import zipped
from tests.commands.command import (
    finish,
    run,
    run_installed,
    same_results,
    start,
    succeed,
    wait_for_records,
)
from tests.commands.conftest import ONE, SCRIPTED
from tests.leaderboard.playing import write_policy


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
    document = (directory / "run.json").read_text()
    assert "reads the simulator's state" in document
    assert "2 of 100 episodes per task" in document


@pytest.mark.slow
def test_the_first_episodes_are_filmed_and_shown_if_asked_for(tmp_path):
    done = run(*SCRIPTED, "--output", "run", "--video", 1, "--replays", 1, directory=tmp_path)
    assert "filming 2 episodes" in done.err
    page = (tmp_path / "run" / "report.html").read_text()
    for folder, suffix in (("videos", "mp4"), ("replays", "html")):
        files = [f"opening-0.{suffix}", f"pushing-0.{suffix}"]
        assert sorted(os.listdir(tmp_path / "run" / folder)) == files
        assert all(f"{folder}/{file}" in page for file in files)


def test_chosen_episodes_hold_the_bits_of_the_whole_run_and_are_a_run(scripted, tmp_path):
    evaluate = ("evaluate", "scripted", "--output", "run", "--episodes-from", "opening/0")
    more = ("--episodes-from", "pushing/1")
    done = succeed(*evaluate, *more, directory=tmp_path)
    assert "unofficial: episodes pushing/1, opening/0 only" in done.out
    two = {("pushing", "1"), ("opening", "0")}
    whole = [row for row in rows(scripted[1]) if (row["task"], row["index"]) in two]
    assert rows(tmp_path / "run") == whole
    own, other = (read_run(place).actions for place in (tmp_path / "run", scripted[1]))
    assert own.keys() == {"pushing/1", "opening/0"}
    assert all(np.array_equal(own[key], other[key]) for key in own)
    for command in (("verify", "run"), ("replay", "run", "pushing/1"), ("report", "run")):
        succeed(*command, directory=tmp_path)
    gone = run("replay", "run", "pushing/0", directory=tmp_path)
    gone.refused(2, "no episode 'pushing/0'; it has pushing/1, opening/0")
    page = (tmp_path / "run" / "report.html").read_text()
    assert "--episodes-from pushing/1 --episodes-from opening/0" in page
    assert "episodes per task" not in page
    succeed(*evaluate, *more, "--resume", directory=tmp_path)
    done = run(*evaluate, "--resume", directory=tmp_path)
    done.refused(6, "chosen: pushing/1, opening/0")


def test_a_training_is_not_played_in_other_tasks_without_a_word(tmp_path):
    write_policy(tmp_path / "trained" / "final.safetensors")
    (tmp_path / "trained" / "config.toml").write_text('task = "pushing"\n')
    words = ("evaluate", "trained", "--suite", "smoke", "--episodes", 1, "--fresh")
    done = run(*words, "--tasks", "pushing,opening", directory=tmp_path)
    assert "trained was trained in pushing: --tasks pushing leaves out" in done.err
    assert "trained in" not in run(*words, "--tasks", "pushing", directory=tmp_path).err


def test_faults_are_counted_and_named_and_the_run_finishes(tmp_path):
    options = ("--trust", "--tasks", "pushing,opening", "--episodes", 1, "--act-timeout", 7.5)
    policy = "misbehaved:FaultInPushing"
    done = run("evaluate", policy, *options, "--output", "run", directory=tmp_path)
    assert done.code == 4
    assert [row["outcome"] for row in rows(tmp_path / "run")] == ["policy_fault", "step_limit"]
    played = read_run(tmp_path / "run")
    assert played.faults.keys() == {"pushing/0"}
    assert played.rows[0].steps == len(played.actions["pushing/0"]) == 2
    assert {row["success"] for row in rows(tmp_path / "run")} == {"false"}
    for file in ("run.json", "report.html"):
        assert "NaN" in (tmp_path / "run" / file).read_text()
    assert '"act_timeout_s": 7.5' in (tmp_path / "run" / "run.json").read_text()


def test_what_a_policy_prints_is_apart_from_the_results(tmp_path):
    options = (*ONE, "--trust", "--isolation", "none", "--output", "run", "--json")
    done = run_installed("evaluate", "misbehaved:Talks", *options, directory=tmp_path)
    assert json.loads(done.out) == json.loads((tmp_path / "run" / "run.json").read_text())
    assert {"made", "from-a-child", "begun", "acting", "ended", "gone"} <= {*done.err.split()}


def test_a_policy_that_is_killed_with_much_memory_is_not_tried_again(tmp_path):
    options = ("--trust", "--isolation", "process", *ONE, "--output", "run")
    done = run("evaluate", "misbehaved:Greedy", *options, directory=tmp_path)
    assert done.code == 5
    assert "pushing/0: the policy's process was killed by SIGKILL while it used 4" in done.err
    assert "--resume" in done.err


@pytest.mark.parametrize(
    ("words", "code", "word"),
    [
        (("gone.pt",), 3, "does not exist"),
        (("file.pt",), 3, "file.pt"),
        (("cut.zip",), 3, "cut.zip"),
        (("misbehaved:Still",), 3, "--trust"),
        (("zero", "--tasks", "flying"), 2, "pick-up"),
        (("zero", "--episodes-from", "pushing/1"), 2, "leave out"),
        (("zero", "--workers", "many"), 2, "--workers"),
        (("zero", "--name", " "), 2, "--name is empty"),
        (("zero", "--isolation", "none"), 2, "--trust"),
        (("zero", "--tasks", "playing", "--exploration", "gone.pt"), 2, "task with a goal"),
        (("zero", "--exploration", "open-loop"), 2, "leave it out"),
        (("zero", "--exploration", "gone.pt"), 3, "gone.pt"),
        (("zero", "--output", "file.pt/run"), 6, "cannot be written"),
        (("zero", "--output", "busy"), 6, "in use"),
    ],
)
def test_a_mistake_is_refused_and_makes_no_directory(tmp_path, words, code, word):
    (tmp_path / "file.pt").write_text("no directory")
    (tmp_path / "cut.zip").write_bytes(zipped({"data": "{}" * 1000})[:-40])
    with lock_directory(tmp_path / "busy"):
        run("evaluate", *words[:1], *ONE[2:], *words[1:], directory=tmp_path).refused(code, word)
    assert set(os.listdir(tmp_path)) == {"cut.zip", "file.pt"}


def test_a_run_that_is_stopped_keeps_its_episodes_and_is_continued(scripted, tmp_path):
    evaluate = (*SCRIPTED, "--output", "run")
    stopped = run(*evaluate, "--stop-after", "0.01s", directory=tmp_path)
    assert stopped.code == 5
    assert "stopped before the last episode" in stopped.err
    assert "--resume" in stopped.err
    assert len((tmp_path / "run" / JOURNAL_FILE).read_bytes().splitlines()) > 1
    succeed(*evaluate, "--resume", directory=tmp_path)
    same_results(tmp_path / "run", scripted[1])


def test_a_directory_that_holds_a_run_is_not_touched(scripted):
    _, directory = scripted
    before = {path.name: path.read_bytes() for path in directory.iterdir()}
    again = run(*SCRIPTED, "--output", directory, directory=directory.parent)
    again.refused(6, "this run of scripted on table4", "--resume", "--fresh")
    for resume in ((), ("--resume",)):
        other = run("evaluate", "zero", *ONE, "--output", directory, *resume, directory=directory)
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
    assert (broken.code, broken.out) == (130, "")
    assert "Traceback" not in broken.err
    assert "--resume" in broken.err or not episodes
    done = succeed(*SCRIPTED, "--output", "run", "--resume", "--json", directory=tmp_path)
    assert json.loads(done.out) == json.loads((tmp_path / "run" / "run.json").read_text())
    same_results(tmp_path / "run", scripted[1])
