"""Whether this machine's kernel holds what the sandbox promises, and what is said if not."""

import os
import struct

import pytest

from minitouch_bench.errors import IsolationError
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.policies import kernel, sandbox
from minitouch_bench.policies.policy import Isolation, IsolationOptions
from minitouch_bench.policies.policy_process import InProcessPolicy, effective_level, isolate
from minitouch_bench.policies.sandbox import ENTERED, readable_paths
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.runs.plan import make_plan

ROOMY = 2**33, 60
"""Bytes of memory and seconds of processor time."""

STAND_INS = {"start a program": lambda _: None, "trace another process": lambda _: None}
"""In place of escapes that would end the child, or stop this process."""


@pytest.mark.parametrize("deed", sandbox.ESCAPES)
def test_a_sandbox_that_does_not_hold_is_found_out(monkeypatch, deed):
    made = sandbox.prepare(*ROOMY)
    monkeypatch.setattr(sandbox.kernel, "install_filter", lambda program: None)
    monkeypatch.setattr(kernel, "restrict_self", lambda ruleset, abi: None)
    monkeypatch.setattr(sandbox, "ESCAPES", {deed: STAND_INS.get(deed, sandbox.ESCAPES[deed])})
    with pytest.raises(IsolationError, match=f"a process in it can {deed}"):
        sandbox.check_holds(made)
    os.close(made.ruleset)


def test_without_seccomp_the_policy_is_refused(monkeypatch):
    monkeypatch.setattr(kernel, "PR_SET_SECCOMP", 0)  # unknown to every kernel
    with pytest.raises(IsolationError, match="refused a part of it"):
        sandbox.prepare(*ROOMY)


@pytest.mark.parametrize(
    ("part", "name", "answer", "text"),
    [
        (kernel, "supported_abi", 0, "no Landlock"),
        (sandbox.platform, "machine", "riscv64", "needs Linux on x86-64"),
        (sandbox.platform, "system", "Darwin", "needs Linux on x86-64"),
    ],
)
def test_without_a_sandbox_the_policy_is_refused_and_the_price_of_less_is_named(
    monkeypatch, part, name, answer, text
):
    monkeypatch.setattr(part, name, lambda: answer)
    with pytest.raises(IsolationError, match=f"{text}.*\\n.*--isolation process") as caught:
        sandbox.prepare(*ROOMY)
    assert caught.value.exit_code == 3


def test_an_old_kernel_is_asked_for_no_more_than_it_knows(monkeypatch):
    asked = []

    def record(number, *arguments):
        asked.append(struct.unpack("=QQQ", arguments[0]))
        return os.open("/dev/null", os.O_RDONLY)

    monkeypatch.setattr(kernel, "system_call", record)
    for abi in range(1, 9):
        os.close(kernel.make_ruleset(abi, ()))
    files, net, scopes = zip(*asked, strict=True)
    assert [rights.bit_length() for rights in files] == [13, 14, 15, 15, 16, 16, 16, 16]
    assert net == (0, 0, 0, 3, 3, 3, 3, 3)
    assert scopes == (0, 0, 0, 0, 0, 3, 3, 3)


@pytest.mark.parametrize("abi", [1, 2, 3])
@pytest.mark.parametrize("flags", [os.O_TRUNC, 3, 3 | os.O_TRUNC, os.O_WRONLY | os.O_TRUNC])
def test_no_file_is_emptied_under_an_older_landlock(monkeypatch, tmp_path, abi, flags):
    monkeypatch.setattr(kernel, "supported_abi", lambda: abi)
    for place in ("readable", "elsewhere"):
        (tmp_path / place).mkdir()
        (tmp_path / place / "file").write_text("kept")
    made = sandbox.prepare(*ROOMY, (str(tmp_path / "readable"),))
    for place in ("readable", "elsewhere"):
        child = os.fork()
        if child == 0:
            try:
                made.enter(())
                os.open(tmp_path / place / "file", flags)
            except PermissionError:
                os._exit(ENTERED)
            finally:
                os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == ENTERED
        assert (tmp_path / place / "file").read_text() == "kept"
    os.close(made.ruleset)


def test_levels_that_cannot_be_had_are_named_as_they_are():
    remote, scripted, zero = map(parse_source, ("http://127.0.0.1:1", "scripted", "zero"))
    assert effective_level(remote, Isolation.SANDBOX) is Isolation.PROCESS
    assert effective_level(scripted, Isolation.SANDBOX) is Isolation.NONE
    assert effective_level(zero, Isolation.SANDBOX) is Isolation.SANDBOX
    assert isinstance(isolate(zero, IsolationOptions(Isolation.NONE)), InProcessPolicy)
    plan = make_plan("smoke")
    assert PolicySetup(plan, zero).isolation_level() is Isolation.SANDBOX
    assert PolicySetup(plan, zero, remote).isolation_level() is Isolation.SANDBOX
    assert PolicySetup(plan, remote, remote).isolation_level() is Isolation.PROCESS


def test_packages_of_another_environment_may_be_read_and_other_folders_of_the_path_not(
    tmp_path, monkeypatch
):
    packages = str(tmp_path / "other" / "site-packages")
    monkeypatch.syspath_prepend(packages)
    monkeypatch.syspath_prepend(str(tmp_path / "mine"))
    assert packages in readable_paths()
    assert str(tmp_path / "mine") not in readable_paths()
