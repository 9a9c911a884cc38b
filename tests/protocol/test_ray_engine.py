"""A real Ray cluster: the same bits, whatever becomes of its nodes."""

import contextlib
import os
import signal
import threading
import warnings
from pathlib import Path

import pytest
import torch

from minitouch_bench.agents.networks import TouchActor
from minitouch_bench.cache import VARIABLE
from minitouch_bench.errors import InfrastructureError
from minitouch_bench.policies.isolation.levels import Isolation
from minitouch_bench.protocol.journal import JOURNAL_FILE
from minitouch_bench.protocol.ray_cluster import ray_cluster
from minitouch_bench.protocol.ray_engine import RayEngine
from minitouch_bench.protocol.storage import ACTIONS_FILE
from minitouch_bench.records import TASK_NAMES
from tests.protocol import ray_nodes
from tests.protocol.ray_nodes import command_line, holds_a_policy
from tests.protocol.runs import digests, request, run

HERE = Path(__file__).parent

needs_ray = pytest.mark.skipif("not __import__('importlib').util.find_spec('ray')")


@pytest.fixture(scope="module")
def script(tmp_path_factory) -> Path:
    """A TorchScript actor for every task."""
    path = tmp_path_factory.mktemp("script") / "actor.pt"
    torch.manual_seed(5)
    example = (torch.zeros(1, 1, 84, 84, dtype=torch.uint8), torch.zeros(1, 11))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.trace(TouchActor(action_size=5).eval(), example).save(path)
    return path


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The address of a cluster of two nodes, which have a cache of their own."""
    pytest.importorskip("ray")
    with pytest.MonkeyPatch.context() as patch, contextlib.ExitStack() as stack:
        patch.setenv("PYTHONPATH", str(HERE))
        patch.setenv(VARIABLE, str(tmp_path_factory.mktemp("nodes")))
        address = stack.enter_context(ray_nodes.head())
        stack.enter_context(ray_nodes.joined(address, 2))
        patch.delenv(VARIABLE)
        yield address


@contextlib.contextmanager
def engine_on(address, workers=None):
    notes = []
    with ray_cluster(address) as ray:
        yield RayEngine(ray, workers, notes.append), notes


# The same bits


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["scripted", "random", "script"])
def test_two_nodes_give_the_bits_of_one_worker_on_every_task(cluster, script, tmp_path, policy):
    wanted = request(str(script) if policy == "script" else policy, TASK_NAMES, 2)
    here = run(wanted, tmp_path / "here", workers=1)
    with engine_on(cluster) as (engine, notes):
        assert engine.workers == 2
        there = run(wanted, tmp_path / "there", engine=engine)
    assert digests(there) == digests(here)
    assert {record.fault for record in there.records} == {""}
    assert there.header == here.header
    actions = [(tmp_path / place / ACTIONS_FILE).read_bytes() for place in ("here", "there")]
    assert actions[0] == actions[1]
    assert notes == []


@pytest.mark.slow
def test_a_run_begun_here_goes_on_there_and_ends_here(finished, cluster, tmp_path):
    done, directory = finished
    lines = (directory / JOURNAL_FILE).read_bytes().splitlines(keepends=True)
    (tmp_path / JOURNAL_FILE).write_bytes(b"".join(lines[:3]))
    wanted = request()
    with engine_on(cluster, 1) as (engine, _):
        again = run(wanted, tmp_path, engine=engine, resume=True)
    assert digests(again) == digests(done)
    lines = (tmp_path / JOURNAL_FILE).read_bytes().splitlines(keepends=True)
    (tmp_path / JOURNAL_FILE).write_bytes(b"".join(lines[:5]))
    assert digests(run(wanted, tmp_path, resume=True)) == digests(done)


@pytest.mark.slow
def test_the_checkpoint_may_go_once_the_episodes_have_begun(cluster, script, tmp_path):
    file = tmp_path / "gone.pt"
    file.write_bytes(script.read_bytes())
    specs = request(str(file), ("pushing",), 4).chosen().episodes(exploration=False)
    wanted = request(str(file), ("pushing",), 4)
    faults = []
    with engine_on(cluster) as (engine, _):
        for record in engine.run(wanted.contest, specs):
            file.unlink(missing_ok=True)
            faults.append(record.fault)
    assert faults == [""] * 4


# Losses


@pytest.mark.slow
def test_a_node_that_joins_is_used_and_its_loss_costs_time_only(cluster, tmp_path):
    wanted = request("zero", TASK_NAMES, 4)
    here = run(wanted, tmp_path, workers=2)
    specs = wanted.chosen().episodes(exploration=False)
    found, used = {}, False
    with contextlib.ExitStack() as stack, engine_on(cluster) as (engine, notes):
        for record in engine.run(wanted.contest, specs):
            assert record.spec.key not in found
            found[record.spec.key] = (record.spec.key, record.outcome, record.trace.digest())
            if len(found) == 1:
                third = stack.enter_context(ray_nodes.joined(cluster, 3))
            elif not used and holds_a_policy(third.process.pid):
                used = True
                third.kill()
    assert used
    assert [found[spec.key] for spec in specs] == digests(here)
    assert ["was lost" in note for note in notes] == [True]


@pytest.mark.slow
def test_a_worker_that_dies_is_replaced_and_its_policy_dies_with_it(cluster, tmp_path):
    wanted = request("zero", ("opening",), 3)
    here = run(wanted, tmp_path)
    specs = wanted.chosen().episodes(exploration=False)
    found, hosts = {}, set()
    with engine_on(cluster, 1) as (engine, notes):
        for record in engine.run(wanted.contest, specs):
            if not found:
                threading.Timer(0.3, kill_workers, (hosts,)).start()
            found[record.spec.key] = (record.spec.key, record.outcome, record.trace.digest())
    assert [found[spec.key] for spec in specs] == digests(here)
    assert len(notes) == 1
    assert hosts
    assert not any(map(command_line, hosts))


def policy_hosts():
    every = {int(path.name) for path in Path("/proc").iterdir() if path.name.isdecimal()}
    return {pid for pid in every if b"policies.host" in command_line(pid)}


def kill_workers(hosts):
    """Kill every worker on this machine that holds a policy, and collect the policies' hosts."""
    for host in policy_hosts():
        worker = int(Path(f"/proc/{host}/stat").read_text().rpartition(")")[2].split()[1])
        if command_line(worker).startswith(b"ray::"):
            hosts.add(host)
            os.kill(worker, signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.parametrize("deaths", [2, 3])
def test_an_episode_is_tried_three_times_where_its_node_stays(cluster, tmp_path, deaths):
    counter = Path("/tmp") / f"deaths-{os.getpid()}"
    counter.write_text(str(deaths))
    wanted = request("misbehaved:KillsItsWorkerOnce", ("opening",), 1, isolation=Isolation.PROCESS)
    specs = wanted.chosen().episodes(exploration=False)
    try:
        with engine_on(cluster) as (engine, _):
            if deaths < 3:
                assert len(list(engine.run(wanted.contest, specs))) == 1
            else:
                with pytest.raises(InfrastructureError, match=r"opening/0 failed 3 times.*lost"):
                    list(engine.run(wanted.contest, specs))
        assert counter.read_text() == "0"
    finally:
        counter.unlink()
