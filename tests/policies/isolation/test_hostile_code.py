"""Code that wants out: a Python factory and a TorchScript module, in real children."""

import errno
import resource
import shutil
import signal
from contextlib import closing
from pathlib import Path

import pytest
from torch import Tensor, nn

from minitouch_bench.errors import PolicyExitError, PolicyLoadError
from minitouch_bench.policies.policy import Isolation, IsolationOptions, zero_observation
from minitouch_bench.policies.policy_process import PolicyProcess, isolate
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.limits import PolicyLimits
from tests.policies.isolation import hostile_factory
from tests.policies.test_memory import export
from tests.process_tree import descendants

LIMITS = PolicyLimits(act_timeout_s=120.0)
OTHER_ERRORS = {
    "find open descriptors": errno.ENOENT,
    "find the simulator": errno.ENOENT,
    "find secrets": errno.ENOENT,
    "find a limit that kills": errno.ENOENT,
    "allocate 10 GB": errno.ENOMEM,
    "use clone3": errno.ENOSYS,
    "use a call of the future": errno.ENOSYS,
    "type into a terminal": errno.ENOTTY,
}


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


def test_calls_by_other_numbers_kill(factory):
    with pytest.raises(PolicyExitError, match="killed by SIGSYS"):
        factory.act(doing("x32"))
    factory.reset(0, "pushing")


class Loops(nn.Module):
    """Never answers."""

    def forward(self, image: Tensor, touch: Tensor) -> Tensor:
        while bool(touch.isfinite().all()):
            touch = touch * 0
        return touch[:, :4]


def test_processor_time_is_limited_too(tmp_path):
    source = parse_source(str(export(Loops(), "script", tmp_path / "policy.pt")))
    with PolicyProcess(source, IsolationOptions(limits=LIMITS)) as policy:
        policy.reset(0, "pushing")
        (child,) = descendants(policy._host.process.pid)
        assert resource.prlimit(child, resource.RLIMIT_CPU)[0] == LIMITS.cpu_s
        resource.prlimit(child, resource.RLIMIT_CPU, (1, resource.RLIM_INFINITY))
        with pytest.raises(PolicyExitError, match=signal.SIGXCPU.name):
            policy.act(zero_observation())


@pytest.mark.parametrize("suffix", ["pt2", "pt", "zip"])
@pytest.mark.parametrize("level", [Isolation.PROCESS, Isolation.NONE])
def test_files_that_run_code_need_trust_out_of_the_sandbox(tmp_path, suffix, level):
    path = tmp_path / f"policy.{suffix}"
    path.write_bytes(b"code")
    policy = isolate(parse_source(str(path)), IsolationOptions(level))
    with closing(policy), pytest.raises(PolicyLoadError, match="add --trust"):
        policy.reset(0, "pushing")
