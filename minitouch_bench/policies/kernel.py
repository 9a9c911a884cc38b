"""What the kernel does for the sandbox: limits, capabilities, descriptors, and Landlock.

Landlock says which files a process can reach: see landlock(7) and linux/landlock.h. The filter of
system calls is ``seccomp``.
"""

import contextlib
import ctypes
import errno
import os
import resource
from collections.abc import Iterable
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


CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # on every architecture
CREATE_RULESET_VERSION = 1
RULE_PATH_BENEATH = 1
RESTRICT_SELF_LOG_SAME_EXEC_OFF = 1

WRITE_FILE, READ_FILE, READ_DIR = 1 << 1, 1 << 2, 1 << 3

FILE_RIGHTS = ((1, 13), (2, 14), (3, 15), (5, 16))
"""From ABI n on, the kernel knows the first m rights over files."""

NET_TCP = 0b11
NET_FROM_ABI = 4
SCOPES = 0b11
"""No connection to abstract Unix sockets, and no signal, out of the domain."""
SCOPES_FROM_ABI = 6
LOG_OFF_FROM_ABI = 7


class RulesetAttributes(ctypes.Structure):
    """``struct landlock_ruleset_attr``; older kernels take it where what they lack is 0."""

    _fields_ = (
        ("handled_access_fs", ctypes.c_uint64),
        ("handled_access_net", ctypes.c_uint64),
        ("scoped", ctypes.c_uint64),
    )


class PathBeneath(ctypes.Structure):
    """``struct landlock_path_beneath_attr``."""

    _pack_ = 1
    _fields_ = (("allowed_access", ctypes.c_uint64), ("parent_fd", ctypes.c_int32))


def supported_abi() -> int:
    """Return the version of Landlock that this kernel has, 0 where there is none."""
    try:
        return system_call(CREATE_RULESET, None, 0, CREATE_RULESET_VERSION)
    except OSError as error:
        if error.errno in (errno.ENOSYS, errno.EOPNOTSUPP, errno.EPERM):  # EPERM: a container's
            return 0
        raise


def make_ruleset(
    abi: int,
    readable: Iterable[str],
    writable: Iterable[str] = (),
    listable: Iterable[str] = (),
) -> int:
    """Return the descriptor of a ruleset that denies all this kernel can deny, save paths.

    Raises:
        OSError: the kernel refuses it.
    """
    handled = (1 << max(count for since, count in FILE_RIGHTS if abi >= since)) - 1
    attributes = RulesetAttributes(
        handled,
        NET_TCP if abi >= NET_FROM_ABI else 0,
        SCOPES if abi >= SCOPES_FROM_ABI else 0,
    )
    size = ctypes.sizeof(attributes)
    ruleset = system_call(CREATE_RULESET, ctypes.byref(attributes), size, 0)
    for path in readable:
        _allow(ruleset, path, READ_FILE | READ_DIR)
    for path in listable:
        _allow(ruleset, path, READ_DIR)
    for path in writable:
        _allow(ruleset, path, READ_FILE | WRITE_FILE)
    return ruleset


def restrict_self(ruleset: int, abi: int) -> None:
    """Put this thread, and all it starts, under a ruleset for good.

    Raises:
        OSError: the kernel refuses it.
    """
    # A policy that is denied the same thing for ever would fill the machine's audit log.
    flags = RESTRICT_SELF_LOG_SAME_EXEC_OFF if abi >= LOG_OFF_FROM_ABI else 0
    system_call(RESTRICT_SELF, ruleset, flags)


def _allow(ruleset: int, path: str, rights: int) -> None:
    with contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError):
        parent = os.open(path, os.O_PATH | os.O_CLOEXEC)
        try:
            if not os.path.isdir(path):
                rights &= ~READ_DIR
            rule = PathBeneath(rights, parent)
            system_call(ADD_RULE, ruleset, RULE_PATH_BENEATH, ctypes.byref(rule), 0)
        finally:
            os.close(parent)
