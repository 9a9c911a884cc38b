"""Checkpoints on the way to machines that do not have them."""

import hashlib
from dataclasses import replace

import pytest

from minitouch_bench.cache import VARIABLE
from minitouch_bench.errors import CheckpointChangedError
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.remote_worker import EpisodeWorker, pack, this_machine, unpack
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.records import EpisodeSpec, Outcome, Role
from minitouch_bench.runs.plan import make_plan

PLAN = make_plan("smoke")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def write(path, content):
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    return path


def test_a_checkpoint_is_the_same_where_its_file_never_was(tmp_path, cache):
    file = write(tmp_path / "actor.pt", b"weights")
    setup = PolicySetup(PLAN, parse_source(str(file)))
    payload = pack(setup)
    file.unlink()
    there, names = unpack(payload)
    assert there.policy.digest == setup.policy.digest
    assert there.policy.name == "actor"
    place = cache / f"policy-{hashlib.sha256(b'weights').hexdigest()[:16]}.pt"
    assert there.policy.target == str(place)
    assert place.read_bytes() == b"weights"
    assert names == {str(place): str(file)}


def test_another_file_under_its_name_is_not_taken_for_it(tmp_path, cache):
    payload = pack(PolicySetup(PLAN, parse_source(str(write(tmp_path / "actor.pt", b"weights")))))
    place = unpack(payload)[0].policy.target
    write(cache / place, b"others")
    assert unpack(payload)[0].policy.target == place
    assert (cache / place).read_bytes() == b"weights"


def test_each_task_keeps_its_own_file_and_exploration_its_own_policy(tmp_path, cache):
    write(tmp_path / "mine" / "pushing.pt", b"one")
    write(tmp_path / "mine" / "opening.onnx", b"two")
    explorer = write(tmp_path / "early.zip", b"three")
    setup = PolicySetup(PLAN, parse_source(str(tmp_path / "mine")), parse_source(str(explorer)))
    there, _ = unpack(pack(setup))
    assert there.policy.digest == setup.policy.digest
    for task, kind, content in (("pushing", "torchscript", b"one"), ("opening", "onnx", b"two")):
        part = there.policy.for_task(task)
        assert (part.kind, hashlib.sha256(content).hexdigest()) == (part.kind, part.digest)
        assert kind == part.kind
        with open(part.target, "rb") as file:
            assert file.read() == content
    with open(there.exploration.target, "rb") as file:
        assert file.read() == b"three"


def test_a_policy_without_a_file_needs_none(cache):
    setup = PolicySetup(PLAN, parse_source("scripted"))
    payload = pack(setup)
    assert payload.files == {}
    assert unpack(payload) == (setup, {})
    assert not cache.exists()


@pytest.mark.parametrize("content", [b"other weights", None])
def test_a_checkpoint_that_changed_meanwhile_is_not_sent(tmp_path, content):
    file = write(tmp_path / "actor.pt", b"weights")
    setup = PolicySetup(PLAN, parse_source(str(file)))
    if content is None:
        file.unlink()
    else:
        file.write_bytes(content)
    with pytest.raises(CheckpointChangedError, match=r"was changed since|does not exist"):
        pack(setup)


def test_a_worker_runs_what_it_was_sent_or_says_why_it_cannot():
    here, worker = this_machine(), EpisodeWorker()
    payload = pack(PolicySetup(PLAN, parse_source("scripted")))
    other = replace(here, protocol_digest="0" * 64)
    assert "its protocol is" in worker.prepare(other, lambda: payload)
    newer = replace(here, parts={**here.parts, "minitouch-bench": "99"})
    assert "and 99 is asked for" in worker.prepare(newer, lambda: payload)
    assert here.unlike(newer) == f"minitouch-bench {here.parts['minitouch-bench']} (here 99)"

    def fail():
        raise OSError("no such payload")

    assert worker.prepare(here, fail) == "OSError: no such payload"
    assert worker.prepare(here, lambda: payload) == ""
    record = worker.run(EpisodeSpec(Role.FINAL, "opening", 0, 7))
    assert record.outcome is Outcome.SUCCESS
