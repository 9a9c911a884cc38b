import os
import subprocess
import sys

import numpy as np
import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.protocol.storage import (
    ACTIONS_FILE,
    RUN_FILES,
    clear_run,
    holds_run,
    lock_directory,
    write_actions,
)

HOLD = """
import sys, time
from pathlib import Path
from minitouch_bench.protocol.storage import lock_directory
with lock_directory(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(1000)
"""


def test_a_directory_is_held_by_one_process_until_it_ends_in_whatever_way(tmp_path):
    directory = tmp_path / "new" / "run"
    command = [sys.executable, "-c", HOLD, str(directory)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with (
            pytest.raises(RunDirectoryError, match="in use by another run"),
            lock_directory(directory),
        ):
            pass
        holder.kill()
    with lock_directory(directory), pytest.raises(RunDirectoryError), lock_directory(directory):
        pass


def test_a_lock_is_not_inherited(tmp_path):
    with lock_directory(tmp_path):
        sleeper = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    with lock_directory(tmp_path):
        sleeper.communicate(b"\n")


@pytest.mark.parametrize("place", ["file/run", "/proc/run"])
def test_a_place_that_cannot_be_written_is_said(tmp_path, place):
    (tmp_path / "file").write_text("no directory")
    with (
        pytest.raises(RunDirectoryError, match="cannot be written"),
        lock_directory(tmp_path / place),
    ):
        pass


def test_clearing_removes_the_run_and_nothing_else(tmp_path):
    for name in (*RUN_FILES, "notes.txt", "policy.pt"):
        (tmp_path / name).write_text("x")
    for name in ("videos", "figures"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.mp4").write_text("x")
    assert holds_run(tmp_path)
    clear_run(tmp_path)
    clear_run(tmp_path)
    assert not holds_run(tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["figures", "notes.txt", "policy.pt"]


def test_actions_are_those_of_the_records_and_always_the_same_bytes(finished, tmp_path):
    run, directory = finished
    write_actions(run.records, tmp_path)
    assert (tmp_path / ACTIONS_FILE).read_bytes() == (directory / ACTIONS_FILE).read_bytes()
    with np.load(tmp_path / ACTIONS_FILE) as stored:
        assert list(stored) == [record.spec.key for record in run.records]
        for record in run.records:
            assert stored[record.spec.key].dtype == np.float32
            assert np.array_equal(stored[record.spec.key], record.trace.actions)
    assert os.listdir(tmp_path) == [ACTIONS_FILE]


def test_actions_that_cannot_be_written_are_said(finished, tmp_path):
    (tmp_path / ACTIONS_FILE).mkdir()
    (tmp_path / ACTIONS_FILE / "x").write_text("x")
    with pytest.raises(RunDirectoryError, match="cannot be written"):
        write_actions(finished[0].records, tmp_path)
