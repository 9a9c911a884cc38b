"""``--engine ray`` as a user meets it: the same run, and nothing left behind."""

import json
import os
import shutil
import signal
import sys
import tempfile

import pytest

from minitouch_bench.files import JOURNAL_FILE
from tests.commands.command import finish, same_results, start, wait_for_records
from tests.commands.command import run_installed as run
from tests.commands.conftest import ONE, SCRIPTED
from tests.evaluation.ray_nodes import free_port
from tests.process_tree import command_line, descendants, wait_until

pytestmark = pytest.mark.skipif(" " in sys.executable, reason="Ray needs a path without a space")

LONG = ("evaluate", "zero", "--tasks", "opening", "--episodes", "40", "--output", "run")


@pytest.fixture
def home(monkeypatch):
    """A user's home and temporary folder, where Ray shall leave nothing."""
    pytest.importorskip("ray")
    folder = tempfile.mkdtemp(prefix="home-")  # pytest's own are too long for Ray's sockets
    monkeypatch.setenv("HOME", folder)
    monkeypatch.setenv("TMPDIR", folder)
    yield folder
    left = [name for name in os.listdir(folder) if "ray" in name]
    shutil.rmtree(folder)
    assert left == []


def test_a_ray_started_here_gives_the_same_numbers_and_leaves_nothing(scripted, home, tmp_path):
    done = run(
        *SCRIPTED, "--engine", "ray", "--workers", 2, "--output", "run", "--json",
        directory=tmp_path,
    )  # fmt: skip
    assert done.code == 0, done.err
    same_results(tmp_path / "run", scripted[1])
    assert json.loads(done.out) == json.loads((tmp_path / "run" / "run.json").read_text())
    lines = done.err.splitlines()
    assert all(line.startswith(("episodes", "pushing ", "report: ")) for line in lines), done.err


@pytest.mark.slow
def test_after_ctrl_c_nothing_is_left_and_the_run_goes_on_without_ray(home, tmp_path):
    process = start(*LONG, "--engine", "ray", "--workers", 2, directory=tmp_path)
    wait_for_records(tmp_path / "run", 2, process)
    family = descendants(process.pid)
    os.killpg(process.pid, signal.SIGINT)
    broken = finish(process)
    assert (broken.code, broken.out) == (130, "")
    assert "Traceback" not in broken.err
    assert "--resume" in broken.err
    wait_until(lambda: not any(map(command_line, family)), 60)
    assert (tmp_path / "run" / JOURNAL_FILE).exists()
    assert run(*LONG, "--resume", directory=tmp_path).code == 0


@pytest.mark.slow
def test_everybody_dies_with_the_command(tmp_path):
    pytest.importorskip("ray")
    process = start(*LONG, "--engine", "ray", "--workers", 2, directory=tmp_path)
    wait_for_records(tmp_path / "run", 1, process)
    family = descendants(process.pid)
    assert any(b"policies.forkserver" in command_line(pid) for pid in family)
    process.kill()
    process.communicate()
    # Two helpers of Ray's own, which hold nothing, first try to tell their head, which is dead.
    ours = [pid for pid in family if b"Agent" not in command_line(pid)]
    wait_until(lambda: not any(map(command_line, ours)), 60)


def test_what_ray_cannot_do_is_refused_and_no_directory_is_made(tmp_path, monkeypatch):
    pytest.importorskip("ray")
    (long := tmp_path / ("long" * 25)).mkdir()
    monkeypatch.setenv("TMPDIR", str(long))  # sockets have short paths
    zero, address = ("evaluate", "zero", *ONE), ("--address", f"127.0.0.1:{free_port()}")
    run(*zero, "--engine", "ray", directory=tmp_path).refused(5, "TMPDIR")
    run(*zero, *address, directory=tmp_path).refused(2, "--engine ray")
    done = run(*zero, "--engine", "ray", *address, directory=tmp_path)
    done.refused(5, address[1], "no Ray cluster answers")
    assert os.listdir(tmp_path) == [long.name]
