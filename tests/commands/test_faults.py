"""What a run survives, beyond what the other tests show."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from minitouch_bench.policies.native import save_native
from minitouch_bench.policies.networks import TouchActor
from tests.commands.command import finish, run, same_results, start, wait_for_records
from tests.process_tree import command_line, descendants, is_alive, wait_until

POLICY = "policy.safetensors"
OPTIONS = ("--tasks", "pushing,opening", "--episodes", "2", "--workers", "2")
EVALUATE = ("evaluate", POLICY, *OPTIONS, "--output", "run")
KILLS = 20

RANDOM = ("evaluate", "random", "--tasks", "pushing,opening", "--episodes", "3", "--workers", "2")
"""Its actions come from each episode's seed, and it starts in no time."""


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Path:
    """A finished run of a checkpoint, with the checkpoint beside it."""
    directory = tmp_path_factory.mktemp("uninterrupted")
    save_native(TouchActor(action_size=5), directory / POLICY)
    done = run(*EVALUATE, directory=directory)
    assert done.code == 0, done.err
    return directory


@pytest.fixture
def place(uninterrupted, tmp_path) -> Path:
    """An empty place with the same checkpoint."""
    shutil.copy(uninterrupted / POLICY, tmp_path)
    return tmp_path


def victims(pid: int, kind: str) -> list[int]:
    """Return the workers below the command, or the processes that hold their policies."""
    program = {"worker": b"minitouch_bench.processes", "policy": b"policies.forkserver"}[kind]
    return [child for child in descendants(pid) if program in command_line(child)]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> Path:
    """A finished run of the random policy."""
    directory = tmp_path_factory.mktemp("undisturbed")
    done = run(*RANDOM, "--output", "run", directory=directory)
    assert done.code == 0, done.err
    return directory / "run"


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_kill_9_of_the_parent_at_20_moments_costs_time_only(undisturbed, tmp_path):
    chance = random.Random(1)
    place = tmp_path / "run"
    killed = 0
    while killed < KILLS:
        (place / ".lock").unlink(missing_ok=True)
        process = start(*RANDOM, "--output", place, "--resume", directory=tmp_path)
        while not (place / ".lock").exists() and process.poll() is None:
            time.sleep(0.001)
        time.sleep(chance.choice([0.0, 0.01, chance.uniform(0.0, 4.0)]))  # opening it, or playing
        killed += process.poll() is None
        below = descendants(process.pid)
        process.kill()
        process.communicate()
        wait_until(lambda left=below: not any(map(is_alive, left)), 10)
        if (place / "run.json").exists():  # it had ended: the next begins anew
            same_results(place, undisturbed)
            shutil.rmtree(place)
    done = run(*RANDOM, "--output", place, "--resume", directory=tmp_path)
    assert done.code == 0, done.err
    same_results(place, undisturbed)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kind", ["worker", "policy"])
def test_kill_9_of_workers_and_policies_changes_nothing(undisturbed, tmp_path, kind):
    chance = random.Random(2)
    place = tmp_path / "run"
    killed = 0
    while killed < KILLS:
        process = start(*RANDOM, "--output", place, "--fresh", directory=tmp_path)
        wait_for_records(place, 0, process)
        for _ in range(2):  # an episode is tried three times
            time.sleep(chance.uniform(0.3, 2.0))
            if found := victims(process.pid, kind):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(chance.choice(found), signal.SIGKILL)
                    killed += 1
        done = finish(process)
        assert done.code == 0, done.err
        same_results(place, undisturbed)


def test_another_checkpoint_under_the_same_name_does_not_resume(uninterrupted, place):
    shutil.copytree(uninterrupted / "run", place / "run")
    save_native(TouchActor(action_size=5), place / POLICY)
    done = run(*EVALUATE, "--resume", directory=place)
    done.refused(6, "another run", "policy: policy ")
    same_results(place / "run", uninterrupted / "run")


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 200 kB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, check=False).returncode != 0:
        pytest.skip("needs the right to mount a tmpfs (root)")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)


def test_a_full_disk_loses_nothing_and_goes_on_when_there_is_room(uninterrupted, place, small_disk):
    filler = small_disk / "filler"
    filler.write_bytes(bytes(170_000))
    options = ("evaluate", POLICY, *OPTIONS, "--output", small_disk / "run")
    full = run(*options, directory=place)
    assert full.code in (5, 6)
    assert "No space left on device" in full.err or "no space left on device" in full.err
    assert "Traceback" not in full.err
    filler.unlink()
    subprocess.run(["mount", "-o", "remount,size=50m", str(small_disk)], check=True)
    done = run(*options, "--resume", directory=place)
    assert done.code == 0, done.err
    same_results(small_disk / "run", uninterrupted / "run")


HOSTILE = (
    '=HYPERLINK("http:evil","x")<script>alert(1)<img src=x>\x1b[31m\x1b]0;owned\x07.safetensors'
)


def test_hostile_names_reach_no_file_terminal_page_or_sheet(uninterrupted, tmp_path):
    shutil.copy(uninterrupted / POLICY, tmp_path / HOSTILE)
    options = ("--tasks", "opening", "--episodes", "1", "--workers", "1")
    done = run("evaluate", tmp_path / HOSTILE, *options, directory=tmp_path)
    assert done.code == 0, done.err
    (directory,) = (tmp_path / "reports").iterdir()
    assert directory.parent == tmp_path / "reports"
    assert all(c.isalnum() or c in "._-" for c in directory.name)
    assert "\x1b" not in done.out + done.err
    page = (directory / "report.html").read_text()
    assert "<script>alert" not in page
    assert "<img src=x" not in page
    cells = (directory / "episodes.csv").read_text().splitlines()
    assert not any(line.startswith(("=", '"=')) for line in cells)
    assert "\x1b" not in page + "".join(cells)
