"""The sandbox as a whole: prepared once in a host, entered by each process it forks."""

import os
import platform
import socket
import struct
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from minitouch_bench.errors import IsolationError
from minitouch_bench.policies.isolation import kernel, landlock, seccomp
from minitouch_bench.policies.isolation.readable import (
    NOTHING,
    WRITABLE,
    FactoryPaths,
    forget_environment,
    readable_paths,
)
from minitouch_bench.policies.isolation.seccomp import ARCHITECTURES, NEITHER_READ_NOR_WRITE
from minitouch_bench.processes import die_with

PRICE = (
    "With --isolation process a policy could read and write your files, use the network and "
    "signal your programs: only for files you trust"
)
ENTERED = 100
"""Exit code of a process that tried the sandbox and found that it holds."""


@dataclass(frozen=True)
class Sandbox:
    """What a process needs to confine itself; ``ruleset`` is a descriptor of Landlock's."""

    machine: str
    abi: int
    ruleset: int
    limits: kernel.ProcessLimits
    threads: bool

    def enter(self, kept: tuple[int, ...]) -> None:
        """Confine this single-threaded process for good; the descriptors ``kept`` stay open.

        Raises:
            OSError: the kernel refused a part of it; the process must end then.
        """
        kernel.set_limits(self.limits)
        forget_environment()
        kernel.close_others((*kept, self.ruleset))
        kernel.prctl(kernel.PR_SET_NO_NEW_PRIVS, 1)
        kernel.drop_capabilities(self.machine)
        landlock.restrict_self(self.ruleset, self.abi)
        os.close(self.ruleset)
        seccomp.install(seccomp.make_filter(self.machine, os.getpid(), threads=self.threads))


def prepare(
    allowed: kernel.ProcessLimits, paths: FactoryPaths = NOTHING, *, threads: bool = False
) -> Sandbox:
    """Return a sandbox, and let the kernel end this process first where memory runs out.

    Raises:
        IsolationError: this machine cannot have one, or it does not hold.
    """
    machine = platform.machine()
    if platform.system() != "Linux":
        raise _unavailable("it needs Linux")
    if machine not in ARCHITECTURES or struct.calcsize("P") != 8:
        raise _unavailable(f"it knows {' and '.join(ARCHITECTURES)} in 64 bits, not {machine}")
    abi = landlock.supported_abi()
    if abi == 0:
        raise _unavailable(
            "the kernel has no Landlock, or its use is forbidden here (Linux 5.13 or later has "
            "it; see /sys/kernel/security/lsm)"
        )
    try:
        readable = (*readable_paths(), *paths.readable)
        ruleset = landlock.make_ruleset(abi, readable, WRITABLE, paths.listable)
    except OSError as error:
        raise _unavailable(f"Landlock refused its rules: {error.strerror}") from error
    sandbox = Sandbox(machine, abi, ruleset, allowed, threads)
    kernel.be_first_to_go()  # children inherit it
    check_holds(sandbox)
    return sandbox


def check_holds(sandbox: Sandbox) -> None:
    """Let a child enter a sandbox and try to break out.

    Raises:
        IsolationError: it could not enter, or got out.
    """
    try:
        with tempfile.NamedTemporaryFile() as file:
            problem, status = _send_in(sandbox, file.name)
    except OSError as error:
        raise _unavailable(f"it cannot be tried out: {error.strerror}") from error
    if status != ENTERED:
        raise _unavailable(problem or f"a process that entered it ended with status {status}")


def _send_in(sandbox: Sandbox, file: str) -> tuple[str, int]:
    """Return what a child reports that entered the sandbox, and its exit code."""
    host = os.getpid()
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            die_with(host)
            _try_out(sandbox, writer, file)
        finally:
            os._exit(1)
    os.close(writer)
    with open(reader, encoding="utf-8", errors="replace") as report:
        problem = report.read()
    return problem, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _try_out(sandbox: Sandbox, report: int, file: str) -> None:
    try:
        sandbox.enter((report,))
    except OSError as error:
        os.write(report, f"the kernel refused a part of it: {error.strerror}".encode())
        return
    escapes: dict[str, Callable[[], object]] = {
        **ESCAPES,
        "write a file": lambda: os.open(file, os.O_WRONLY),
        "empty a file": lambda: os.open(file, NEITHER_READ_NOR_WRITE | os.O_TRUNC),
    }
    for deed, attempt in escapes.items():
        try:
            attempt()
        except PermissionError:
            continue
        except OSError as error:
            os.write(report, f"whether it can {deed} is unclear: {error.strerror}".encode())
            return
        os.write(report, f"a process in it can {deed}".encode())
        return
    os.close(os.open(os.__file__, os.O_RDONLY))  # and Python must be able to go on
    os._exit(ENTERED)


def _fork() -> None:
    if os.fork() == 0:
        os._exit(0)


ESCAPES: Mapping[str, Callable[[], object]] = {
    "list the root folder": lambda: os.listdir("/"),
    "read /etc/passwd": lambda: os.open("/etc/passwd", os.O_RDONLY),
    "open a socket": socket.socket,
    "start a process": _fork,
    "start a program": lambda: os.execv("/proc/self/exe", ["x", "-c", ""]),
    "signal another process": lambda: os.kill(os.getppid(), 0),
    "trace another process": lambda: kernel.system_call(
        {"x86_64": 101, "aarch64": 117}[platform.machine()], 16, os.getppid(), 0, 0
    ),
}


def _unavailable(reason: str) -> IsolationError:
    return IsolationError(f"no sandbox can be had here: {reason}.\n{PRICE}")
