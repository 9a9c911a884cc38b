import math
import os
import platform
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from minitouch_bench.errors import InfrastructureError, UsageError
from minitouch_bench.processes import ARITHMETIC, cpu_quota, interrupts_held, run_in_workers
from tests.process_tree import is_alive, run_python, wait_until

SINES = """
import hashlib, numpy as np
x = np.random.default_rng(0).uniform(-3, 3, 100_000)
print(hashlib.sha256(np.sin(x).tobytes()).hexdigest())
m = np.random.default_rng(1).normal(size=(300, 300))
print(hashlib.sha256((m @ m).tobytes()).hexdigest())
"""


@pytest.mark.skipif(platform.machine() != "x86_64", reason="settings of x86-64")
def test_numpy_heeds_them_without_a_word(monkeypatch):
    for name in ARITHMETIC:
        monkeypatch.delenv(name)
    results = [
        run_python("-c", SINES, **extra)
        for extra in (ARITHMETIC, {**ARITHMETIC, "OPENBLAS_NUM_THREADS": "1"}, {})
    ]
    assert results[0].stderr == ""
    assert results[0].stdout == results[1].stdout
    with open("/proc/cpuinfo", encoding="utf-8") as file:
        newer = "avx512f" in file.read()
    if newer:  # else the settings are what this processor does anyway
        assert results[0].stdout != results[2].stdout


@pytest.mark.parametrize(
    ("limits", "cores"),
    [
        ({}, math.inf),
        ({"pod/box": "max 100000"}, math.inf),
        ({"pod/box": "max 100000", "pod": "350000 100000", ".": "400000 100000"}, 3.5),
        ({"pod/box": "50000 100000", "pod": "350000 100000"}, 0.5),
    ],
)
def test_a_container_s_quota_limits_the_cores(tmp_path, limits, cores):
    (own := tmp_path / "own").write_text("4:memory:/elsewhere\n0::/pod/box\n")
    (tmp_path / "root/pod/box").mkdir(parents=True)
    for group, limit in limits.items():
        (tmp_path / "root" / group / "cpu.max").write_text(f"{limit}\n")
    assert cpu_quota(tmp_path / "root", own) == cores


# Workers: these functions run in them, and files tell one process from the next.


class Counter:
    """Counts its calls; it is copied to each worker once."""

    calls = 0

    def __call__(self, _):
        self.calls += 1
        return os.getpid(), self.calls


def die_until(path):
    """Die by kill -9 as often as a file says, then answer."""
    left = int(Path(path).read_text())
    if left:
        Path(path).write_text(str(left - 1))
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def fail(path):
    with open(path, "a", encoding="utf-8") as file:
        file.write(f"{os.getpid()}\n")
    raise ValueError("no luck")


def blame_the_user(path):
    Path(path).touch(exist_ok=False)
    raise UsageError("no such thing")


def stay(path):
    Path(path).write_text(str(os.getpid()))
    time.sleep(1000)


def run_named(function, jobs, workers=1, **options):
    named = run_in_workers(
        function, jobs, workers, name=lambda job: f"job {Path(job).name}", **options
    )
    return dict(named)


def test_a_worker_keeps_its_function_from_job_to_job():
    found = [*run_named(Counter(), ["a"] * 6, 2).values()]
    processes = {process for process, _ in found}
    assert os.getpid() not in processes
    assert len({*found}) == 6  # no process has counted to one number twice
    assert max(count for _, count in found) >= 3


def test_breaking_off_ends_the_workers():
    found = run_in_workers(Counter(), ["a"] * 9, 2, name=str)
    _, (process, _) = next(found)
    found.close()
    wait_until(lambda: not is_alive(process))


def test_workers_compute_with_the_fixed_settings(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    found = run_named(os.getenv, list(ARITHMETIC))
    assert dict(zip(ARITHMETIC, found.values(), strict=True)) == ARITHMETIC
    assert os.environ["OMP_NUM_THREADS"] == "7"


def test_the_job_of_a_dead_worker_is_tried_three_times(tmp_path):
    jobs = [str(tmp_path / name) for name in "ab"]
    for job, deaths in zip(jobs, (2, 0), strict=True):
        Path(job).write_text(str(deaths))
    assert set(run_named(die_until, jobs)) == {0, 1}
    Path(jobs[1]).write_text("3")
    with pytest.raises(InfrastructureError, match=r"job b failed 3 times.*exit code -9"):
        run_named(die_until, jobs[1:])
    assert Path(jobs[1]).read_text() == "0"
    Path(jobs[0]).write_text("3")  # it may have a result then, and the others go on
    found = run_named(die_until, jobs, ended=str.upper)
    assert "EXIT CODE -9" in found.pop(0)
    assert found.keys() == {1}


def test_a_function_that_raises_is_tried_in_three_processes_and_a_user_s_mistake_once(tmp_path):
    file = tmp_path / "a"
    with pytest.raises(InfrastructureError, match=r"^job a failed 3 times: ValueError: no luck$"):
        run_named(fail, [str(file)], ended=str.upper)  # its worker lives
    assert len(set(file.read_text().split())) == 3
    with pytest.raises(UsageError, match=r"^no such thing$"):
        run_named(blame_the_user, [str(tmp_path / "b")])


def test_a_worker_that_cannot_be_started_ends_the_others(tmp_path, monkeypatch):
    job, started = tmp_path / "a", []

    def start(*arguments, **options):
        if len(started) == 2:
            raise OSError(12, "Cannot allocate memory")
        started.append(popen(*arguments, **options))
        return started[-1]

    popen = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", start)
    job.write_text("1")
    with pytest.raises(InfrastructureError, match=r"no worker .*Cannot allocate memory"):
        run_named(die_until, [str(job), str(job)], 2)
    assert all(process.poll() is not None for process in started)


PARENT = """
import sys
from tests.test_processes import run_named, stay
if __name__ == "__main__":
    run_named(stay, sys.argv[1:], 2)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_their_parent_and_never_see_ctrl_c(tmp_path, number):
    """Ctrl-C reaches the whole group, as a terminal sends it; the parent alone answers."""
    (tmp_path / "parent.py").write_text(PARENT)
    files = [tmp_path / name for name in "ab"]
    parent = subprocess.Popen(
        [sys.executable, tmp_path / "parent.py", *files],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while not all(file.exists() and file.read_text() for file in files):
        assert parent.poll() is None
        time.sleep(0.05)
    workers = [int(file.read_text()) for file in files]
    (os.kill if number == signal.SIGKILL else os.killpg)(parent.pid, number)
    errors = parent.communicate(timeout=60)[1]
    assert parent.returncode == -number
    assert errors.count("KeyboardInterrupt") == (number == signal.SIGINT)
    wait_until(lambda: not any(map(is_alive, workers)))


# Interrupts


def test_ctrl_c_waits_for_the_end_of_the_block_and_what_it_starts_never_sees_one():
    code = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('alive')"
    with pytest.raises(KeyboardInterrupt), interrupts_held():  # noqa: PT012
        os.kill(os.getpid(), signal.SIGINT)
        child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert child.communicate()[0] == "alive\n"
