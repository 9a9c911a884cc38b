"""What the kernel does for the sandbox: limits, capabilities, Landlock, and a filter of calls.

Landlock says which files a process can reach: see landlock(7) and linux/landlock.h.

The filter of system calls is classic BPF: see seccomp(2). It lists what is allowed, because the
kernel gains calls every year and a list of what is forbidden would let each new one through. What
is not on it answers EPERM, which Python shows as PermissionError; what is younger than the list
answers ENOSYS, on which the C library falls back to older calls. Calls of another architecture,
and x32's, have numbers that mean something else, and nobody makes them by accident: they kill the
process.
"""

import contextlib
import csv
import ctypes
import errno
import os
import resource
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path

PR_SET_SECCOMP = 22
PR_SET_NO_NEW_PRIVS = 38

LIBC = ctypes.CDLL(None, use_errno=True)

MAX_DESCRIPTORS = 64
MAX_TASKS = 4096
"""Processes and threads of the user, all in all; does not bind root."""

PRCTL, CAPSET = 157, 126
CAPABILITY_VERSION_3 = 0x20080522
PAGE = os.sysconf("SC_PAGE_SIZE")


def system_call(number: int, *arguments: object) -> int:
    """Make a system call and return its answer; integers are passed as 64 bits.

    Raises:
        OSError: with the kernel's error number.
    """
    widened = [ctypes.c_ulong(value) if isinstance(value, int) else value for value in arguments]
    answer: int = LIBC.syscall(ctypes.c_long(number), *widened)
    if answer < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return answer


def prctl(option: int, *arguments: object) -> int:
    """Call ``prctl``, as ``system_call`` does; what is not given is 0."""
    return system_call(PRCTL, option, *(*arguments, 0, 0, 0, 0)[:4])


def set_limits(memory_bytes: int, cpu_s: int) -> None:
    """Limit this process for good: memory beyond what is mapped now, and processor time.

    A file that it may write has 0 bytes.
    """
    with open("/proc/self/statm", encoding="ascii") as file:
        mapped = int(file.read().split()[0]) * PAGE
    for kind, most in (
        (resource.RLIMIT_AS, mapped + memory_bytes),
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
    _lower(resource.RLIMIT_CPU, cpu_s, resource.RLIM_INFINITY)


def be_first_to_go() -> None:
    """Have the kernel take this process and its children first where memory runs out."""
    with open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
        file.write("1000")


def drop_capabilities() -> None:
    """Give up what root can do beyond its own files; nothing to others."""
    header = (ctypes.c_uint32 * 2)(CAPABILITY_VERSION_3, 0)
    none = (ctypes.c_uint32 * 6)()
    system_call(CAPSET, ctypes.byref(header), ctypes.byref(none))


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


def supported_abi() -> int:
    """Return the version of Landlock that this kernel has, 0 where there is none."""
    try:
        return system_call(CREATE_RULESET, None, 0, CREATE_RULESET_VERSION)
    except OSError:  # the kernel has none, or a container forbids it
        return 0


def make_ruleset(
    abi: int, readable: Iterable[str], writable: Iterable[str] = (), listable: Iterable[str] = ()
) -> int:
    """Return the descriptor of a ruleset that denies all this kernel can deny, save paths."""
    handled = (1 << max(count for since, count in FILE_RIGHTS if abi >= since)) - 1
    net, scopes = NET_TCP * (abi >= NET_FROM_ABI), SCOPES * (abi >= SCOPES_FROM_ABI)
    # struct landlock_ruleset_attr; older kernels take it where what they lack is 0.
    attributes = struct.pack("=QQQ", handled, net, scopes)
    ruleset = system_call(CREATE_RULESET, attributes, len(attributes), 0)
    for path in readable:
        _allow(ruleset, path, READ_FILE | READ_DIR)
    for path in listable:
        _allow(ruleset, path, READ_DIR)
    for path in writable:
        _allow(ruleset, path, READ_FILE | WRITE_FILE)
    return ruleset


def restrict_self(ruleset: int, abi: int) -> None:
    """Put this thread, and all it starts, under a ruleset for good."""
    # A policy that is denied the same thing for ever would fill the machine's audit log.
    flags = RESTRICT_SELF_LOG_SAME_EXEC_OFF if abi >= LOG_OFF_FROM_ABI else 0
    system_call(RESTRICT_SELF, ruleset, flags)


def _allow(ruleset: int, path: str, rights: int) -> None:
    with contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError):
        parent = os.open(path, os.O_PATH | os.O_CLOEXEC)
        try:
            if not os.path.isdir(path):
                rights &= ~READ_DIR
            rule = struct.pack("=Qi", rights, parent)  # struct landlock_path_beneath_attr
            system_call(ADD_RULE, ruleset, RULE_PATH_BENEATH, rule, 0)
        finally:
            os.close(parent)


CALLS = Path(__file__).with_name("system_calls.csv")
"""The calls of the filter; the file says which are allowed always, and which are judged."""


def read_calls(how: str) -> Mapping[str, int]:
    """Return the numbers of the calls that are "allowed" or "judged"."""
    lines = (line for line in CALLS.read_text("utf-8").splitlines() if not line.startswith("#"))
    rows = csv.DictReader(lines)
    return {row["name"]: int(row["number"]) for row in rows if row["how"] == how}


ALLOWED, JUDGED = read_calls("allowed"), read_calls("judged")

FIRST_UNKNOWN = 450
"""From this number on, a call is younger than this table."""


AUDIT_ARCH = 0xC000003E
X32_BIT = 0x40000000
SECCOMP_MODE_FILTER = 2

KILL_PROCESS = 0x80000000
ERRNO = 0x00050000
ALLOW = 0x7FFF0000

LOAD, RETURN, AND = 0x20, 0x06, 0x54
IF_EQUAL, IF_AT_LEAST, IF_ANY_BIT = 0x15, 0x35, 0x45
NUMBER_AT, ARCHITECTURE_AT, ARGUMENTS_AT = 0, 4, 16

ACCESS_MODE = 0b11
"""The bits of the flags that say whether a file is read or written."""
NEITHER_READ_NOR_WRITE = 3
"""The mode that Linux has beside O_RDONLY, O_WRONLY and O_RDWR; Landlock lets it open any file."""
O_RDONLY, O_TRUNC = 0, 0o1000
CLONE_THREAD = 0x00010000
NEGATIVE = 1 << 31
"""A negative clock is the processor time of a process that its number names."""
MAP_SHARED = 0b1  # MAP_SHARED_VALIDATE has it, too
NAME_CALLS = (15, 16)
READING_PRCTL = (2, 3, 21, 23, 39, 51, 64)
"""Of itself: parent-death signal, dumpable, seccomp, capabilities, privileges, SVE, SME."""
PR_SET_VMA = 0x53564D41
HARMLESS_IOCTL = (0x5401, 0x5413, 0x541B, 0x5421, 0x5450, 0x5451)
"""TCGETS, TIOCGWINSZ, FIONREAD, FIONBIO, FIONCLEX, FIOCLEX."""
HARMLESS_FCNTL = (0, 1, 2, 3, 4, 1030, 1032)
"""Duplicates and flags. F_SETOWN and F_SETSIG would have the kernel send signals to others."""

HARMLESS_MADVISE = (0, 1, 2, 4, 8, 14, 15, 16, 17, 102, 103)
"""About its own memory: order of use, no longer needed, huge pages, dumps, guards. Not what
reads a file ahead, puts pages out of memory, or merges them with those of others."""
NOT_TO_ITSELF = (9, 19)
"""SIGKILL and SIGSTOP, which would look like the doing of somebody else."""

Instruction = tuple[int, int, int, int]
"""Code, jump if true, jump if false, constant."""


GRANTED: list[Instruction] = [(RETURN, 0, 0, ALLOW)]
DENIED: list[Instruction] = [(RETURN, 0, 0, ERRNO | errno.EPERM)]


def make_filter(pid: int, *, threads: bool) -> list[Instruction]:
    """Return the filter for a process."""
    program = [
        *_load(ARCHITECTURE_AT),
        (IF_EQUAL, 1, 0, AUDIT_ARCH),
        *_answer(KILL_PROCESS),
        *_load(NUMBER_AT),
        (IF_AT_LEAST, 0, 1, X32_BIT),
        *_answer(KILL_PROCESS),
    ]
    for number in ALLOWED.values():
        program += [(IF_EQUAL, 0, 1, number), *GRANTED]
    for name, block in _judgments(pid, threads=threads).items():
        program += [(IF_EQUAL, 0, len(block), JUDGED[name]), *block]
    program += [(IF_AT_LEAST, 0, 1, FIRST_UNKNOWN), *_answer(ERRNO | errno.ENOSYS)]
    return program + DENIED


def install_filter(program: Iterable[Instruction]) -> None:
    """Put this thread, and all it starts, under a filter for good."""
    code = b"".join(struct.pack("=HBBI", *instruction) for instruction in program)
    kept = ctypes.create_string_buffer(code)
    header = struct.pack("HP", len(code) // 8, ctypes.addressof(kept))  # struct sock_fprog
    prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, header)


def _judgments(pid: int, *, threads: bool) -> Mapping[str, list[Instruction]]:
    """Return what decides on each call that is judged by its arguments."""
    thread = [*_low(0), *_allow_if(IF_ANY_BIT, (CLONE_THREAD,))] if threads else []
    options = (*NAME_CALLS, *READING_PRCTL, PR_SET_VMA)
    clocks = ("clock_gettime", "clock_getres", "clock_nanosleep")
    clock = [*_low(0), (IF_ANY_BIT, 0, 1, NEGATIVE), *DENIED, *GRANTED]
    return {
        **dict.fromkeys(clocks, clock),
        "open": _opening(1),
        "openat": _opening(2),
        "clone": thread + DENIED,
        # Its flags are in memory, which a filter cannot read: as if the kernel had none.
        "clone3": _answer(ERRNO | errno.ENOSYS),
        "kill": _signal_to_itself(pid, 1),
        "tkill": _signal_to_itself(pid, 1),
        "tgkill": _signal_to_itself(pid, 2),
        "madvise": [*_low(2), *_allow_if(IF_EQUAL, HARMLESS_MADVISE), *DENIED],
        "prctl": [*_low(0), *_allow_if(IF_EQUAL, options), *DENIED],
        "ioctl": [*_low(1), *_allow_if(IF_EQUAL, HARMLESS_IOCTL), *_answer(ERRNO | errno.ENOTTY)],
        "fcntl": [*_low(1), *_allow_if(IF_EQUAL, HARMLESS_FCNTL), *DENIED],
        "prlimit64": _reading_prlimit(pid),
        # Shared memory has no limit: it is for trusted code, which alone may start threads.
        "mmap": GRANTED
        if threads
        else [*_low(3), (IF_ANY_BIT, 0, 1, MAP_SHARED), *DENIED, *GRANTED],
    }


def _opening(argument: int) -> list[Instruction]:
    """Allow to open a file as Landlock permits; the argument is the flags.

    Before its third version (Linux 6.2) Landlock does not see that ``O_TRUNC`` empties a file.
    With ``O_WRONLY`` and ``O_RDWR`` it asks for the right to write; otherwise it is denied here.
    """
    return [
        *_low(argument),
        (AND, 0, 0, ACCESS_MODE),
        (IF_EQUAL, 0, 1, NEITHER_READ_NOR_WRITE),
        *DENIED,
        (IF_EQUAL, 0, 3, O_RDONLY),
        *_low(argument),
        (IF_ANY_BIT, 0, 1, O_TRUNC),
        *DENIED,
        *GRANTED,
    ]


def _signal_to_itself(pid: int, argument: int) -> list[Instruction]:
    """Allow a process to signal itself; the argument is the signal's."""
    forbidden = [part for number in NOT_TO_ITSELF for part in ((IF_EQUAL, 0, 1, number), *DENIED)]
    return [*_low(argument), *forbidden, *_low(0), *_allow_if(IF_EQUAL, (pid,)), *DENIED]


def _reading_prlimit(pid: int) -> list[Instruction]:
    """Allow a process to ask for its own limits, with no pointer to new ones."""
    return [
        *_low(0),
        (IF_EQUAL, 2, 0, 0),
        (IF_EQUAL, 1, 0, pid),
        *DENIED,
        *_low(2),
        (IF_EQUAL, 1, 0, 0),
        *DENIED,
        *_load(ARGUMENTS_AT + 8 * 2 + 4),
        (IF_EQUAL, 1, 0, 0),
        *DENIED,
        *GRANTED,
    ]


def _allow_if(test: int, values: Iterable[int]) -> list[Instruction]:
    return [part for value in values for part in ((test, 0, 1, value), *GRANTED)]


def _low(argument: int) -> list[Instruction]:
    """Load an argument's low half, all that the kernel takes of an ``int``; little-endian."""
    return _load(ARGUMENTS_AT + 8 * argument)


def _load(offset: int) -> list[Instruction]:
    return [(LOAD, 0, 0, offset)]


def _answer(action: int) -> list[Instruction]:
    return [(RETURN, 0, 0, action)]
