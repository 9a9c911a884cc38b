"""Real policy processes, and everything that can go wrong in one."""

import subprocess
import sys
import time
from dataclasses import replace

import pytest

from minitouch_bench.errors import (
    CheckpointChangedError,
    InfrastructureError,
    InvalidActionError,
    OutOfMemoryError,
    PolicyExitError,
    PolicyKilledError,
    PolicyLoadError,
    PolicyRaisedError,
    PolicyTimeoutError,
)
from minitouch_bench.evaluation.policy_setup import try_policy
from minitouch_bench.policies.policy import Isolation, IsolationOptions, zero_observation
from minitouch_bench.policies.policy_process import PolicyProcess
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.limits import PolicyLimits
from tests.policies.misbehaving import RESET_EXITS, RESET_RAISES, RESET_SLEEPS, SEEDS
from tests.process_tree import is_alive, run_python, wait_until

OBSERVATION = zero_observation()
LIMITS = PolicyLimits(load_timeout_s=60.0, act_timeout_s=60.0)
SOON_S = 30.0
"""Well before the act's deadline: a death is seen at once, not by waiting for it."""


def factory(attribute):
    return parse_source(f"misbehaving:{attribute}")


@pytest.fixture(scope="module")
def bad():
    """One host for all these tests: that it goes on working is part of what they show."""
    with PolicyProcess(
        factory("Misbehaving"), IsolationOptions(Isolation.PROCESS, trust=True, limits=LIMITS)
    ) as policy:
        yield policy


@pytest.mark.parametrize(
    ("how", "error", "text"),
    [
        ("raise", PolicyRaisedError, "^the policy said: ValueError: I am lost !!!"),
        ("sys_exit_text", PolicyRaisedError, r"^the policy said: SystemExit: going home \(misb"),
        ("os_exit", PolicyExitError, "exited with code 9: last words$"),
        ("kill", PolicyKilledError, "killed by SIGKILL$"),
        ("kill_grown", OutOfMemoryError, "killed by SIGKILL while it used [3-5][0-9][0-9] MiB"),
        ("close_pipes", PolicyExitError, "closed its connection$"),
        ("speak_nonsense", PolicyExitError, "broke the protocol: a packet of kind 255"),
        ("speak_at_length", PolicyExitError, "a packet of kind 4 with 65537 bytes"),
        ("cut_short", PolicyExitError, "an action of 15 bytes, not 16"),
        ("claim_absence", PolicyExitError, "UNREACHABLE in place of ACTION"),
        ("claim_refusal", PolicyExitError, "REFUSED in place of ACTION"),
        ("nan", InvalidActionError, "NaN"),
    ],
)
def test_a_fault_is_named_at_once_and_the_next_episode_is_fine(bad, how, error, text):
    bad.reset(SEEDS[how], "pushing")
    began = time.monotonic()
    with pytest.raises(error, match=text) as caught:
        bad.act(OBSERVATION)
    assert time.monotonic() - began < SOON_S
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400
    bad.reset(SEEDS["fine"], "pushing")
    assert bad.act(OBSERVATION).tolist() == [0.25] * 4


def test_an_answer_before_the_question_is_a_fault(bad):
    bad.reset(SEEDS["answer_ahead"], "pushing")
    assert bad.act(OBSERVATION).tolist() == [1.0] * 4
    wait_until(lambda: bad._channel._received or bad._channel._take())
    with pytest.raises(PolicyExitError, match="answered before it was asked"):
        bad.act(OBSERVATION)


def test_a_policy_cannot_say_for_its_loader_that_it_is_ready(bad, monkeypatch):
    monkeypatch.setattr(bad, "_source", factory("ready_at_once"))
    words = "answered before it was asked|in place of"
    with pytest.raises(PolicyExitError, match=words):  # noqa: PT012
        bad.reset(0, "pushing")
        bad.act(OBSERVATION)  # if its second packet came late


@pytest.mark.parametrize("how", ["sleep", "flood"])
def test_no_answer_in_time_is_a_timeout(bad, monkeypatch, how):
    monkeypatch.setattr(bad, "_limits", PolicyLimits(act_timeout_s=1.0))
    bad.reset(SEEDS[how], "pushing")
    began = time.monotonic()
    with pytest.raises(PolicyTimeoutError, match=r"no action within 1 s$"):
        bad.act(OBSERVATION)
    assert 0.9 < time.monotonic() - began < 30.0
    bad.reset(SEEDS["fine"], "pushing")
    assert bad.act(OBSERVATION).tolist() == [0.25] * 4


def test_an_episode_has_a_limit_of_time_too(bad, monkeypatch):
    monkeypatch.setattr(bad, "_limits", PolicyLimits(act_timeout_s=60.0, episode_timeout_s=90.0))
    bad.reset(SEEDS["be_slow"], "pushing")
    before = bad._left_s
    assert bad.act(OBSERVATION).tolist() == [0.0] * 4
    assert bad._left_s < before - 0.2
    bad._left_s = 0.1  # an act takes 0.3 s
    with pytest.raises(PolicyTimeoutError, match=r"its episode took more than 90 s$"):
        bad.act(OBSERVATION)


@pytest.mark.parametrize(("how", "answers"), [("print_much", [0, 0, 0]), ("count", [1, 2, 3])])
def test_an_episode_remembers_nothing_of_the_one_before_and_may_print(bad, how, answers):
    for _ in range(2):
        bad.reset(SEEDS[how], "pushing")
        assert [bad.act(OBSERVATION)[0] for _ in range(3)] == answers


def test_a_child_dies_with_its_episode_and_a_dead_host_is_replaced(bad):
    bad.reset(SEEDS["count"], "pushing")
    child, host = (int(number) for number in bad.act(OBSERVATION)[1:3])
    bad.reset(SEEDS["kill_host"], "pushing")
    wait_until(lambda: not is_alive(child))
    with pytest.raises(InfrastructureError, match="host"):
        bad.act(OBSERVATION)
    wait_until(lambda: not is_alive(host))
    bad.reset(SEEDS["count"], "pushing")
    assert int(bad.act(OBSERVATION)[2]) != host


@pytest.mark.parametrize(
    ("what", "error", "text"),
    [
        (RESET_RAISES, PolicyRaisedError, "KeyError: 'pushing'"),
        (RESET_EXITS, PolicyExitError, "exited with code 5"),
        (RESET_SLEEPS, PolicyTimeoutError, "reset did not return within 5 s"),
        ("sleep", PolicyLoadError, "it was not loaded within 5 s"),
        ("raise_error", PolicyLoadError, "ValueError: I am lost"),
        ("leave_saying", PolicyLoadError, "exited with code 9: last words"),
        ("not_a_policy", PolicyLoadError, "dict is not a policy"),
        ("claiming_factory", PolicyLoadError, "CONFINED in place of LOADED"),
        ("missing", PolicyLoadError, "cannot be imported"),
    ],
)
def test_what_cannot_be_loaded_is_told_from_a_fault_in_reset(bad, monkeypatch, what, error, text):
    if "within" in text:
        monkeypatch.setattr(bad, "_limits", PolicyLimits(load_timeout_s=5.0))
    if isinstance(what, str):
        monkeypatch.setattr(bad, "_source", factory(what))
    with pytest.raises(error, match=text):
        bad.reset(what if isinstance(what, int) else 0, "pushing")


def test_its_warning_is_one_line_and_an_exploration_policy_is_told_to_sample(bad, monkeypatch):
    monkeypatch.setattr(bad, "_source", factory("Forgetful"))
    bad.reset(SEEDS["fine"], "pushing")
    assert bad.warning == "it forgets much"
    for deterministic in (True, False):
        told = replace(factory("told_factory"), deterministic=deterministic)
        monkeypatch.setattr(bad, "_source", told)
        bad.reset(0, "pushing")
        assert bad.act(OBSERVATION)[0] == float(deterministic)


@pytest.mark.parametrize("level", [Isolation.SANDBOX, Isolation.NONE])
def test_a_file_that_changes_during_the_evaluation_is_no_fault_of_the_policy(tmp_path, level):
    path = tmp_path / "x.onnx"
    path.write_bytes(b"one")
    source = parse_source(str(path))
    path.write_bytes(b"two")
    with pytest.raises(CheckpointChangedError, match="was changed"):
        try_policy(source, ["pushing"], IsolationOptions(level))
    path.unlink()
    with pytest.raises(CheckpointChangedError, match="does not exist"):
        try_policy(source, ["pushing"], IsolationOptions(level))


def test_probe_refuses_a_bad_file_but_leaves_faults_to_episodes(tmp_path, light):
    (tmp_path / "opening.onnx").write_bytes(b"plain text")
    (tmp_path / "pushing.safetensors").hardlink_to(light / "policy.safetensors")
    source = parse_source(str(tmp_path))
    try_policy(source, ["pushing"])
    with pytest.raises(PolicyLoadError, match="not a readable onnx policy"):
        try_policy(source, ["pushing", "opening"])
    try_policy(parse_source("scripted"), ["pushing"])
    options = IsolationOptions(Isolation.PROCESS, trust=True)
    try_policy(factory("Misbehaving"), ["pushing"], options)


WITHOUT_FORK = """
import os, socket
import msgspec
from minitouch_bench.policies import forkserver, wire
from minitouch_bench.policies.policy import Isolation, IsolationOptions
from minitouch_bench.policies.sources import parse_source
ours, theirs = socket.socketpair()
order = wire.StartOrder(parse_source("zero"), "pushing", 0)
socket.send_fds(ours, [msgspec.json.encode(order)], [0, 1])
os.fork = lambda: os.open("/no/process", os.O_RDONLY)
forkserver.serve_episodes(theirs, wire.HostSetup("zero", IsolationOptions(Isolation.PROCESS)))
"""


def test_a_host_that_cannot_fork_ends_at_once():
    ended = run_python("-c", WITHOUT_FORK, code=1)
    assert ended.stderr.splitlines()[-1].startswith("FileNotFoundError")


WORKER = """
import sys, time
from minitouch_bench.policies.policy import IsolationOptions, zero_observation
from minitouch_bench.policies.policy_process import PolicyProcess
from minitouch_bench.policies.sources import parse_source
policy = PolicyProcess(parse_source("misbehaving:Misbehaving"), IsolationOptions(trust=True))
policy.reset(int(sys.argv[1]), "pushing")
print(*policy.act(zero_observation())[1:3].astype(int), "torch" in sys.modules, flush=True)
time.sleep(1000)
"""


def test_host_and_child_die_with_the_worker_which_has_no_torch():
    command = [sys.executable, "-c", WORKER, str(SEEDS["count"])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as worker:
        assert worker.stdout is not None
        child, host, has_torch = worker.stdout.readline().split()
        worker.kill()
    assert has_torch == "False"
    wait_until(lambda: not is_alive(int(child)))
    wait_until(lambda: not is_alive(int(host)))
