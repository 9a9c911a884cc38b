"""What the kernel does by itself: limits, capabilities, descriptors; and its system calls."""

import ctypes
import os
import resource
from dataclasses import dataclass

PR_SET_SECCOMP = 22
PR_SET_NO_NEW_PRIVS = 38

LIBC = ctypes.CDLL(None, use_errno=True)

MAX_DESCRIPTORS = 64
MAX_TASKS = 4096
"""Processes and threads of the user, all in all; does not bind root."""

CAPSET = {"x86_64": 126, "aarch64": 91}
CAPABILITY_VERSION_3 = 0x20080522
PAGE = os.sysconf("SC_PAGE_SIZE")


def system_call(number: int, *arguments: object) -> int:
    """Make a system call and return its answer; integers are passed as 64 bits.

    Raises:
        OSError: with the kernel's error number.
    """
    return _checked(LIBC.syscall(ctypes.c_long(number), *_widened(arguments)))


def prctl(option: int, *arguments: object) -> int:
    """Call ``prctl``.

    Raises:
        OSError: with the kernel's error number.
    """
    padded = (*arguments, 0, 0, 0, 0)[:4]
    return _checked(LIBC.prctl(ctypes.c_int(option), *_widened(padded)))


def _widened(arguments: tuple[object, ...]) -> list[object]:
    return [ctypes.c_ulong(value) if isinstance(value, int) else value for value in arguments]


def _checked(answer: int) -> int:
    if answer < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return answer


@dataclass(frozen=True)
class ProcessLimits:
    """Most memory beyond what is mapped at the start, in bytes, and processor time, in s."""

    memory_bytes: int
    cpu_s: int


def set_limits(limits: ProcessLimits) -> None:
    """Limit this process for good; a file it may write has 0 bytes."""
    with open("/proc/self/statm", encoding="ascii") as file:
        mapped = int(file.read().split()[0]) * PAGE
    for kind, most in (
        (resource.RLIMIT_AS, mapped + limits.memory_bytes),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_NOFILE, MAX_DESCRIPTORS),
        (resource.RLIMIT_NPROC, MAX_TASKS),
        (resource.RLIMIT_MEMLOCK, 0),
        (resource.RLIMIT_MSGQUEUE, 0),
    ):
        _lower(kind, most, most)
    # No hard limit: its SIGKILL would look like somebody else's. Who ignores SIGXCPU meets the
    # limits of wall time.
    _lower(resource.RLIMIT_CPU, limits.cpu_s, resource.RLIM_INFINITY)


def be_first_to_go() -> None:
    """Have the kernel take this process and its children first where memory runs out."""
    with open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
        file.write("1000")


def drop_capabilities(machine: str) -> None:
    """Give up what root can do beyond its own files; nothing to others."""
    header = (ctypes.c_uint32 * 2)(CAPABILITY_VERSION_3, 0)
    none = (ctypes.c_uint32 * 6)()
    system_call(CAPSET[machine], ctypes.byref(header), ctypes.byref(none))


def close_others(kept: tuple[int, ...]) -> None:
    """Close every descriptor but the standard streams and those kept."""
    first = 3
    for descriptor in sorted(kept):
        os.closerange(first, descriptor)
        first = descriptor + 1
    os.closerange(first, 2**31 - 1)


def _lower(kind: int, soft: int, hard: int) -> None:
    _, most = resource.getrlimit(kind)
    if most != resource.RLIM_INFINITY:
        soft, hard = min(soft, most), most if hard == resource.RLIM_INFINITY else min(hard, most)
    resource.setrlimit(kind, (soft, hard))
