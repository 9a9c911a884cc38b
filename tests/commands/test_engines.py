"""``--engine ray`` as a user meets it: the same run, and nothing left behind."""

import json
import os
import shutil
import signal
import sys
import tempfile
import time

import pytest

from minitouch_bench.files import JOURNAL_FILE
from tests.commands.command import finish, start
from tests.commands.command import run_installed as run
from tests.commands.conftest import SCRIPTED
from tests.commands.test_evaluate import ONE, same_numbers, wait_for_records
from tests.evaluation.ray_nodes import command_line, descendants, free_port, head, joined
from tests.evaluation.test_engine import wait_until

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


def wait_until_gone(family, helpers_s=90.0):
    """Wait for the end of a command's processes.

    Where Ray could not be ended in good order, two helpers of its own, which hold nothing, go
    last: they try to tell their head first, which is dead.
    """
    ours = [pid for pid in family if b"Agent" not in command_line(pid)]
    wait_until(lambda: not any(map(command_line, ours)), 5.0)
    wait_until(lambda: not any(map(command_line, family)), helpers_s)


def test_a_ray_started_here_gives_the_same_numbers_and_leaves_nothing(scripted, home, tmp_path):
    done = run(
        *SCRIPTED, "--engine", "ray", "--workers", 2, "--output", "run", "--json",
        directory=tmp_path,
    )  # fmt: skip
    assert done.code == 0, done.err
    same_numbers(tmp_path / "run", scripted[1])
    document = json.loads(done.out)
    assert document == json.loads((tmp_path / "run" / "run.json").read_text())
    assert document["digest"] == json.loads((scripted[1] / "run.json").read_text())["digest"]
    lines = done.err.splitlines()
    assert all(line.startswith(("episodes", "pushing ", "report: ")) for line in lines), done.err


@pytest.mark.slow
def test_a_cluster_gives_the_same_numbers(scripted, home, tmp_path):
    with head() as address, joined(address, 2):
        options = ("--engine", "ray", "--address", address, "--output", "run")
        done = run(*SCRIPTED, *options, directory=tmp_path)
    assert done.code == 0, done.err
    same_numbers(tmp_path / "run", scripted[1])
    assert json.loads((tmp_path / "run" / "run.json").read_text())["environment"]["workers"] == 2


@pytest.mark.slow
def test_after_ctrl_c_nothing_is_left_and_the_run_goes_on_without_ray(home, tmp_path):
    process = start(*LONG, "--engine", "ray", "--workers", 2, directory=tmp_path)
    wait_for_records(tmp_path / "run", 2, process)
    family = descendants(process.pid)
    began = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    broken = finish(process)
    assert time.monotonic() - began < 10.0
    assert (broken.code, broken.out) == (130, "")
    assert "Traceback" not in broken.err
    assert "--resume" in broken.err
    wait_until_gone(family, helpers_s=5.0)
    assert (tmp_path / "run" / JOURNAL_FILE).exists()
    done = run(*LONG, "--resume", directory=tmp_path)
    assert done.code == 0


@pytest.mark.slow
@pytest.mark.parametrize("moment", [2.0, 4.0])
def test_ctrl_c_while_ray_starts_ends_it_as_well(home, tmp_path, moment):
    process = start(*LONG, "--engine", "ray", directory=tmp_path)
    time.sleep(moment)
    family = descendants(process.pid)
    os.killpg(process.pid, signal.SIGINT)
    broken = finish(process)
    assert broken.code == 130
    assert "Traceback" not in broken.err
    wait_until_gone(family)


@pytest.mark.slow
def test_everybody_dies_with_the_command(tmp_path):
    pytest.importorskip("ray")
    process = start(*LONG, "--engine", "ray", "--workers", 2, directory=tmp_path)
    wait_for_records(tmp_path / "run", 1, process)
    family = descendants(process.pid)
    assert any(b"policies.forkserver" in command_line(pid) for pid in family)
    process.kill()
    process.communicate()
    wait_until_gone(family)


def test_an_address_without_ray_or_that_is_none_is_a_mistake(tmp_path):
    words = ("evaluate", "zero", *ONE)
    run(*words, "--address", "10.0.0.1:6379", directory=tmp_path).refused(2, "--engine ray")
    done = run(*words, "--engine", "ray", "--address", "ray://head:10001", directory=tmp_path)
    done.refused(2, "HOST:PORT", "ray://head:10001")
    assert os.listdir(tmp_path) == []


def test_where_no_cluster_answers_no_directory_is_made(tmp_path):
    pytest.importorskip("ray")
    address = f"127.0.0.1:{free_port()}"
    done = run(
        "evaluate", "zero", *ONE, "--engine", "ray", "--address", address, directory=tmp_path
    )
    done.refused(5, address, "no Ray cluster answers")
    assert os.listdir(tmp_path) == []
