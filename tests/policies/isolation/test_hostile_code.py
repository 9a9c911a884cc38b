"""Code that wants out: a Python factory and TorchScript modules, in real children."""

import errno
import resource
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest

from minitouch_bench.errors import (
    PolicyExitError,
    PolicyLoadError,
    PolicyTimeoutError,
)
from minitouch_bench.policies.policy import Isolation, IsolationOptions, zero_observation
from minitouch_bench.policies.policy_process import PolicyProcess, isolate
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.limits import PolicyLimits
from tests.policies.isolation import hostile_factory, hostile_modules
from tests.process_tree import descendants

LIMITS = PolicyLimits(act_timeout_s=10.0)
OTHER_ERRORS = {
    "find open descriptors": errno.EMFILE,
    "find the simulator": errno.ENOENT,
    "find secrets": errno.ENOENT,
    "find a limit that kills": errno.ENOENT,
    "allocate 10 GB": errno.ENOMEM,
    "use clone3": errno.ENOSYS,
    "use a call of the future": errno.ENOSYS,
    "type into a terminal": errno.ENOTTY,
}
x86_64_only = pytest.mark.skipif(
    hostile_factory.MACHINE != "x86_64", reason="the calls' numbers are those of x86_64"
)


def doing(deed):
    observation = zero_observation()
    observation["touch"][0] = list(hostile_factory.ALL).index(deed)
    return observation


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Where the factory lies, in folders that Landlock has to know as the factory's."""
    directory = tmp_path_factory.mktemp("home")
    shutil.copy(hostile_factory.__file__, directory)
    return directory


@pytest.fixture(scope="module")
def factory(home):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(home), prepend=":")
        patch.setenv("MINITOUCH_SECRET", "s3cret")
        source = parse_source("hostile_factory:Hostile")
        with PolicyProcess(source, IsolationOptions(trust=True, limits=LIMITS)) as policy:
            policy.reset(0, "pushing")
            yield policy


@x86_64_only
@pytest.mark.parametrize("deed", hostile_factory.DEEDS)
def test_a_factory_cannot(factory, home, deed):
    wanted = {OTHER_ERRORS[deed]} if deed in OTHER_ERRORS else {errno.EPERM, errno.EACCES}
    assert factory.act(doing(deed))[0] in wanted
    assert not (home / "canary").exists()


@pytest.mark.parametrize("deed", hostile_factory.HARMLESS)
def test_a_factory_can(factory, deed):
    assert factory.act(doing(deed))[0] == 0


def test_flags_of_the_standard_streams_are_not_remembered(factory):
    factory.reset(0, "pushing")
    assert factory.act(doing("leave flags"))[0] == 0
    assert factory.act(doing("find flags"))[0] == 0
    factory.reset(0, "pushing")
    assert factory.act(doing("find flags"))[0] == errno.ENOENT


def test_a_host_in_the_sandbox_has_no_secrets_and_no_memory_that_episodes_share(factory):
    host = Path("/proc", str(factory._host.process.pid))
    maps = [line.split()[1] for line in (host / "maps").read_text().splitlines()]
    assert not [rights for rights in maps if "w" in rights and "s" in rights]
    environment = (host / "environ").read_bytes()
    assert b"s3cret" not in environment
    assert b"PYTHONPATH" in environment


@x86_64_only
def test_calls_by_other_numbers_kill(factory):
    with pytest.raises(PolicyExitError, match="killed by SIGSYS"):
        factory.act(doing("x32"))
    factory.reset(0, "pushing")


@pytest.fixture(scope="module")
def scripts():
    """One host for all modules."""
    with PolicyProcess(parse_source("zero"), IsolationOptions(limits=LIMITS)) as policy:
        yield policy


def begin(policy, module, directory, monkeypatch):
    path = directory / "policy.pt"
    path.write_bytes(hostile_modules.saved(module))
    monkeypatch.setattr(policy, "_source", parse_source(str(path)))
    policy.reset(0, "pushing")


@pytest.mark.parametrize("module", [hostile_modules.Loops, hostile_modules.Floods])
def test_a_module_that_never_answers_is_ended(scripts, tmp_path, monkeypatch, module):
    begin(scripts, module(), tmp_path, monkeypatch)
    monkeypatch.setattr(scripts, "_limits", PolicyLimits(act_timeout_s=0.5))
    with pytest.raises(PolicyTimeoutError, match=r"no action within 0\.5 s"):
        scripts.act(zero_observation())


def test_processor_time_is_limited_too(scripts, tmp_path, monkeypatch):
    begin(scripts, hostile_modules.Loops(), tmp_path, monkeypatch)
    (child,) = descendants(scripts._host.process.pid)
    assert resource.prlimit(child, resource.RLIMIT_CPU)[0] == LIMITS.cpu_s
    resource.prlimit(child, resource.RLIMIT_CPU, (1, resource.RLIM_INFINITY))
    monkeypatch.setattr(scripts, "_limits", PolicyLimits(act_timeout_s=120.0))
    with pytest.raises(PolicyExitError, match=signal.SIGXCPU.name):
        scripts.act(zero_observation())


def test_a_module_that_mutates_its_observation_changes_its_copy(
    scripts, tmp_path, monkeypatch, observation
):
    begin(scripts, hostile_modules.Mutates(), tmp_path, monkeypatch)
    before = {name: value.copy() for name, value in observation.items()}
    for _ in range(2):
        assert np.array_equal(scripts.act(observation), before["touch"][:4])
    assert all(np.array_equal(before[name], observation[name]) for name in before)


@pytest.mark.parametrize("suffix", ["pt2", "pt", "zip"])
def test_files_that_run_code_need_trust_out_of_the_sandbox(tmp_path, suffix):
    path = tmp_path / f"policy.{suffix}"
    path.write_bytes(hostile_modules.saved(hostile_modules.Loops()))
    for level in (Isolation.PROCESS, Isolation.NONE):
        policy = isolate(parse_source(str(path)), IsolationOptions(level, limits=LIMITS))
        with pytest.raises(PolicyLoadError, match="add --trust"):
            policy.reset(0, "pushing")
        policy.close()
