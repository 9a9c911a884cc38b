"""Worker processes that die: replaced, retried, and never left behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.evaluation.execution import header_of
from minitouch_bench.evaluation.rollout import LocalEngine
from minitouch_bench.files import JOURNAL_FILE
from minitouch_bench.policies.policy import Isolation
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.runs.plan import suite_episodes
from tests.evaluation.runs import digests, request, run

ROOT = Path(__file__).parents[2]


def children(pid):
    """Return the ids of all live descendants of a process."""
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        own = {int(word) for task in tasks for word in (task / "children").read_text().split()}
    except FileNotFoundError:
        return set()
    return own | {found for child in own for found in children(child)}


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_until(holds, seconds=30.0):
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def is_worker(pid):
    try:
        return b"minitouch_bench.processes" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except FileNotFoundError:
        return False


def test_a_worker_killed_from_outside_is_replaced_and_its_episode_repeated(finished):
    wanted = request()
    specs = header_of(wanted).specs()
    records = {}
    for record in LocalEngine(1).run(wanted, specs):
        if not records:
            for pid in filter(is_worker, children(os.getpid())):
                os.kill(pid, signal.SIGKILL)
        records[record.spec.key] = (record.spec.key, record.outcome, record.trace.digest())
    assert [records[spec.key] for spec in specs] == digests(finished[0])


@pytest.mark.parametrize("deaths", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_an_episode_is_tried_three_times(tmp_path, monkeypatch, importable, deaths):
    counter = tmp_path / "deaths"
    counter.write_text(str(deaths))
    monkeypatch.setenv("DEATHS", str(counter))
    deadly = "misbehaved:KillsItsWorkerOnce"
    wanted = request(deadly, ("opening",), 1, isolation=Isolation.PROCESS)
    directory = tmp_path / "run"
    if deaths < 3:
        done = run(wanted, directory)
        quiet = run(request("zero", ("opening",), 1), tmp_path / "quiet")
        assert digests(done) == digests(quiet)
    else:
        with pytest.raises(InfrastructureError, match=r"opening/0 failed 3 times.*-9"):
            run(wanted, directory)
        assert (directory / JOURNAL_FILE).read_bytes().count(b"\n") == 0
    assert counter.read_text() == "0"
    wait_until(lambda: not any(map(is_worker, children(os.getpid()))))


def test_no_episodes_need_no_workers():
    assert list(LocalEngine(4).run(request(), ())) == []


def test_breaking_off_ends_the_workers():
    wanted = request("zero")
    specs = suite_episodes(PROTOCOL.suite("table4"))
    records = LocalEngine(2).run(wanted, specs[:10])
    next(records)
    records.close()
    assert not any(map(is_worker, children(os.getpid())))


PARENT = """
import sys
from pathlib import Path
from tests.evaluation.runs import request, run
if __name__ == "__main__":
    run(request("random", ("playing",), 50), Path(sys.argv[1]), workers=2)
"""


def test_everybody_dies_with_the_parent(tmp_path):
    (tmp_path / "parent.py").write_text(PARENT)
    command = [sys.executable, str(tmp_path / "parent.py"), str(tmp_path / "run")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, env=environment) as parent:
        # Two workers, and each has its policy's host and that its child.
        wait_until(lambda: len(children(parent.pid)) >= 6)
        family = children(parent.pid)
        parent.kill()
    wait_until(lambda: not any(map(alive, family)), 5.0)
    assert (tmp_path / "run" / JOURNAL_FILE).exists()
