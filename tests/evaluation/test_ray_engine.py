"""A real Ray cluster: the same bits, whatever becomes of its nodes."""

import contextlib
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from minitouch_bench.errors import CheckpointChangedError, InfrastructureError, UsageError
from minitouch_bench.evaluation.execution import header_of
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.evaluation.ray_engine import pack_source
from minitouch_bench.files import ACTIONS_FILE, VARIABLE
from minitouch_bench.policies.formats import KIND_BY_SUFFIX
from minitouch_bench.policies.policy import Isolation
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.runs.plan import make_plan
from tests.evaluation import ray_nodes
from tests.evaluation.ray_nodes import engine_at
from tests.evaluation.runs import digests, request, run
from tests.leaderboard.playing import write_policy

pytestmark = pytest.mark.skipif(" " in sys.executable, reason="Ray needs a path without a space")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory) -> Path:
    """An actor for every task."""
    return write_policy(tmp_path_factory.mktemp("checkpoint") / "actor.safetensors")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The address of a cluster of two nodes, which have a cache of their own."""
    pytest.importorskip("ray")
    with pytest.MonkeyPatch.context() as patch, contextlib.ExitStack() as stack:
        patch.setenv(VARIABLE, str(tmp_path_factory.mktemp("nodes")))
        patch.setenv("DEATHS", str(tmp_path_factory.mktemp("deaths") / "counter"))
        address = stack.enter_context(ray_nodes.head())
        stack.enter_context(ray_nodes.joined(address, 2))
        patch.delenv(VARIABLE)
        yield address


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["scripted", "random", "checkpoint"])
def test_two_nodes_give_the_bits_of_one_worker_on_every_task(cluster, checkpoint, tmp_path, policy):
    wanted = request(str(checkpoint) if policy == "checkpoint" else policy, TASK_NAMES, 2)
    here = run(wanted, tmp_path / "here", workers=1)
    with engine_at(cluster) as engine:
        assert engine.workers == 2
        there = run(wanted, tmp_path / "there", engine=engine)
    assert digests(there) == digests(here)
    assert there.digest == here.digest
    assert there.faults == {}
    assert there.header == here.header
    actions = [(tmp_path / place / ACTIONS_FILE).read_bytes() for place in ("here", "there")]
    assert actions[0] == actions[1]


def test_each_task_keeps_its_own_file_and_exploration_its_own_policy_unless_one_changed(tmp_path):
    contents = {"mine/pushing.pt": b"one", "mine/opening.onnx": b"two", "early.zip": b"three"}
    for name, content in contents.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    sources = [parse_source(str(tmp_path / name)) for name in ("mine", "early.zip")]
    setup = PolicySetup(make_plan("smoke"), *sources)
    there = pack_source(setup)
    assert there.policy.digest == setup.policy.digest
    found = [there.policy.for_task("pushing"), there.policy.for_task("opening"), there.exploration]
    for source, (name, content) in zip(found, contents.items(), strict=True):
        assert source.kind == KIND_BY_SUFFIX[Path(name).suffix]
        assert source.content == content
    (tmp_path / "early.zip").write_bytes(b"other weights")
    with pytest.raises(CheckpointChangedError):
        pack_source(setup)


@pytest.mark.slow
@pytest.mark.parametrize("deaths", [2, 3])
def test_an_episode_is_tried_three_times(cluster, deaths):
    counter = Path(os.environ["DEATHS"])
    counter.write_text(str(deaths))
    wanted = request("misbehaved:KillsItsWorkerOnce", ("opening",), 1, isolation=Isolation.PROCESS)
    specs = header_of(wanted).specs()
    with engine_at(cluster) as engine:
        if deaths < 3:
            assert len(list(engine.run(wanted, specs))) == 1
        else:
            with pytest.raises(InfrastructureError, match=r"opening/0 .*was lost"):
                list(engine.run(wanted, specs))
    assert counter.read_text() == "0"


# Nodes that cannot do

OTHER_PROTOCOL = """
import sys
if any("default_worker.py" in word for word in sys.orig_argv):
    import dataclasses
    from minitouch_bench.protocol import minitouch
    minitouch.PROTOCOL = dataclasses.replace(minitouch.PROTOCOL, name="minitouch-v0")
"""


@pytest.mark.slow
def test_a_node_with_another_protocol_is_refused_in_one_line(tmp_path):
    pytest.importorskip("ray")
    (tmp_path / "sitecustomize.py").write_text(OTHER_PROTOCOL)
    path = f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"
    wanted = request(episodes=12)
    told = r"node [\d.]+ has other versions: protocol \w{12} there, \w{12} here$"
    with (
        ray_nodes.head() as address,
        ray_nodes.joined(address, 2, PYTHONPATH=path),
        engine_at(address) as engine,
        pytest.raises(InfrastructureError, match=told) as refused,
    ):
        run(wanted, tmp_path / "there", engine=engine)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("address", ["10.0.0.1", "ray://10.0.0.1:10001", "a:b"])
def test_what_is_not_an_address_is_a_mistake(address):
    with pytest.raises(UsageError, match=r"HOST:PORT"):
        engine_at(address)


def test_the_ray_of_the_caller_is_left_alone(monkeypatch):
    ray = SimpleNamespace(is_initialized=lambda: True)  # which nobody can shut down
    monkeypatch.setitem(sys.modules, "ray", ray)
    with pytest.raises(UsageError, match="uses Ray already"), engine_at(None):
        pass
