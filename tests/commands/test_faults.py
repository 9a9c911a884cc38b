import contextlib
import os
import random
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from minitouch_bench.files import JOURNAL_FILE
from minitouch_bench.policies.native import save_native
from minitouch_bench.policies.networks import TouchActor
from tests.commands.command import finish, run, same_results, start, succeed, wait_for_records
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
    succeed(*EVALUATE, directory=directory)
    return directory


@pytest.fixture(scope="module")
def undisturbed(uninterrupted) -> Path:
    """A finished run of the random policy."""
    succeed(*RANDOM, "--output", "random", directory=uninterrupted)
    return uninterrupted / "random"


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_kill_9_of_the_parent_at_20_moments_costs_time_only(undisturbed, tmp_path):
    chance = random.Random(1)
    place = tmp_path / "run"
    killed, kept = 0, []
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
        wait_until(lambda left=below: not any(map(is_alive, left)), 60)
        if (place / JOURNAL_FILE).exists():
            kept.append((place / JOURNAL_FILE).read_bytes().count(b"\n") - 1)
        if (place / "run.json").exists():  # it had ended: the next begins anew
            same_results(place, undisturbed)
            shutil.rmtree(place)
    assert max(kept) > 0  # some kill came between the first episode and the last
    succeed(*RANDOM, "--output", place, "--resume", directory=tmp_path)
    same_results(place, undisturbed)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("program", [b"minitouch_bench.processes", b"policies.forkserver"])
def test_kill_9_of_workers_and_policies_changes_nothing(undisturbed, tmp_path, program):
    chance = random.Random(2)
    place = tmp_path / "run"
    killed = 0
    while killed < KILLS:
        process = start(*RANDOM, "--output", place, "--fresh", directory=tmp_path)
        wait_for_records(place, 0, process)
        for _ in range(2):  # an episode is tried three times
            time.sleep(chance.uniform(0.3, 2.0))
            below = descendants(process.pid)
            if found := [child for child in below if program in command_line(child)]:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(chance.choice(found), signal.SIGKILL)
                    killed += 1
        done = finish(process)
        assert done.code == 0, done.err
        same_results(place, undisturbed)


def test_another_checkpoint_under_the_same_name_does_not_resume(uninterrupted, tmp_path):
    shutil.copytree(uninterrupted / "run", tmp_path / "run")
    save_native(TouchActor(action_size=5), tmp_path / POLICY)
    done = run(*EVALUATE, "--resume", directory=tmp_path)
    done.refused(6, "another run", "policy: policy ")
    same_results(tmp_path / "run", uninterrupted / "run")


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


def test_a_full_disk_loses_nothing_and_goes_on_when_there_is_room(uninterrupted, small_disk):
    filler = small_disk / "filler"
    filler.write_bytes(bytes(170_000))
    options = ("evaluate", POLICY, *OPTIONS, "--output", small_disk / "run")
    full = run(*options, directory=uninterrupted)
    assert full.code in (5, 6)
    assert "no space left on device" in full.err.lower()
    assert "Traceback" not in full.err
    filler.unlink()
    subprocess.run(["mount", "-o", "remount,size=50m", str(small_disk)], check=True)
    succeed(*options, "--resume", directory=uninterrupted)
    same_results(small_disk / "run", uninterrupted / "run")


HOSTILE = '=HYPERLINK("http:evil","x")<script>alert(1)<img src=x>\x1b[31m\x1b]0;owned\x07'


def test_hostile_names_reach_no_file_terminal_page_or_sheet(uninterrupted, tmp_path):
    policy = shutil.copy(uninterrupted / POLICY, tmp_path / f"{HOSTILE}.safetensors")
    options = ("--tasks", "opening", "--episodes", "1", "--workers", "1")
    done = succeed("evaluate", policy, *options, directory=tmp_path)
    (directory,) = (tmp_path / "reports").iterdir()
    assert re.fullmatch(r"[\w.-]+", directory.name)
    page, cells = ((directory / name).read_text() for name in ("report.html", "episodes.csv"))
    assert "\x1b" not in done.out + done.err + page + cells
    assert not re.search("<script>alert|<img src=x", page)
    assert not re.search('^"?=', cells, re.MULTILINE)
