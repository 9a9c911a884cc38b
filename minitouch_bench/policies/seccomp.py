"""A seccomp filter for policies, written in classic BPF. See seccomp(2).

It is a list of what is allowed, because the kernel gains calls every year and a list of what
is forbidden would let each new one through. What is not on it answers EPERM, which Python
shows as PermissionError; what is younger than the list answers ENOSYS, on which the C library
falls back to older calls. Calls of another architecture, and x32's, have numbers that mean
something else, and nobody makes them by accident: they kill the process.

Calls stand by their numbers (x86_64, aarch64), None where an architecture has no such call:
``asm/unistd_64.h`` and, for aarch64, ``asm-generic/unistd.h``.
"""

import ctypes
import errno
import struct
from collections.abc import Iterable, Mapping

from minitouch_bench.policies.kernel import PR_SET_SECCOMP, prctl

ARCHITECTURES = ("x86_64", "aarch64")

ALLOWED: Mapping[str, tuple[int | None, int | None]] = {
    "read": (0, 63), "write": (1, 64), "readv": (19, 65), "writev": (20, 66), "pread64": (17, 67),
    "pwrite64": (18, 68), "close": (3, 57), "close_range": (436, 436),
    "stat": (4, None), "fstat": (5, 80), "lstat": (6, None),
    "newfstatat": (262, 79), "statx": (332, 291), "lseek": (8, 62), "access": (21, None),
    "faccessat": (269, 48), "faccessat2": (439, 439), "readlink": (89, None),
    "readlinkat": (267, 78), "getdents64": (217, 61), "getcwd": (79, 17), "dup": (32, 23),
    "dup2": (33, None), "dup3": (292, 24), "pipe": (22, None), "pipe2": (293, 59),
    "poll": (7, None), "ppoll": (271, 73), "select": (23, None), "pselect6": (270, 72),
    "statfs": (137, 43), "fstatfs": (138, 44),
    # memory; code may be made at run time, which the kernels of oneDNN are
    "mmap": (9, 222), "munmap": (11, 215), "mprotect": (10, 226), "mremap": (25, 216),
    "brk": (12, 214), "membarrier": (324, 283),
    # itself: threads, signals it takes, clocks, names
    "futex": (202, 98), "set_robust_list": (273, 99), "set_tid_address": (218, 96),
    "rseq": (334, 293), "sched_yield": (24, 124), "sched_getaffinity": (204, 123),
    "getcpu": (309, 168), "rt_sigaction": (13, 134), "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139), "rt_sigpending": (127, 136), "rt_sigtimedwait": (128, 137),
    "sigaltstack": (131, 132), "restart_syscall": (219, 128), "getpid": (39, 172),
    "getppid": (110, 173), "gettid": (186, 178), "getuid": (102, 174), "geteuid": (107, 175),
    "getgid": (104, 176), "getegid": (108, 177), "getgroups": (115, 158), "getresuid": (118, 148),
    "getresgid": (120, 150), "getpgrp": (111, None), "getpgid": (121, 155), "getsid": (124, 156),
    "clock_gettime": (228, 113), "clock_getres": (229, 114), "clock_nanosleep": (230, 115),
    "nanosleep": (35, 101), "gettimeofday": (96, 169), "time": (201, None), "times": (100, 153),
    "getrusage": (98, 165), "getrlimit": (97, 163), "sysinfo": (99, 179), "uname": (63, 160),
    "getrandom": (318, 278), "wait4": (61, 260), "waitid": (247, 95), "arch_prctl": (158, None),
    "exit": (60, 93), "exit_group": (231, 94),
}  # fmt: skip
"""Calls with which a process changes nothing but itself.

``mincore`` and ``fadvise64`` are not among them: they tell and change which parts of files are
in memory, where one episode could leave a message to the next.
"""

JUDGED: Mapping[str, tuple[int | None, int | None]] = {
    "open": (2, None), "openat": (257, 56),
    "madvise": (28, 233), "clone": (56, 220), "clone3": (435, 435), "kill": (62, 129),
    "tkill": (200, 130), "tgkill": (234, 131), "prctl": (157, 167), "ioctl": (16, 29),
    "fcntl": (72, 25), "prlimit64": (302, 261),
}  # fmt: skip
"""Calls that are allowed or not by their arguments; Landlock says which files open."""

FIRST_UNKNOWN = 450
"""From this number on, a call is younger than this table, on both architectures."""


AUDIT_ARCH = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
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


class Program(ctypes.Structure):
    """``struct sock_fprog``."""

    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_char_p))


def make_filter(machine: str, pid: int, *, threads: bool) -> list[Instruction]:
    """Return the filter for a process.

    Raises:
        ValueError: the architecture is not known here.
    """
    column = ARCHITECTURES.index(machine)
    program = [
        *_load(ARCHITECTURE_AT),
        (IF_EQUAL, 1, 0, AUDIT_ARCH[machine]),
        *_answer(KILL_PROCESS),
        *_load(NUMBER_AT),
    ]
    if machine == "x86_64":
        program += [(IF_AT_LEAST, 0, 1, X32_BIT), *_answer(KILL_PROCESS)]
    for numbers in ALLOWED.values():
        if (number := numbers[column]) is not None:
            program += [(IF_EQUAL, 0, 1, number), *_answer(ALLOW)]
    for name, block in _judgments(pid, threads=threads).items():
        if (number := JUDGED[name][column]) is not None:
            program += [(IF_EQUAL, 0, len(block), number), *block]
    program += [(IF_AT_LEAST, 0, 1, FIRST_UNKNOWN), *_answer(ERRNO | errno.ENOSYS)]
    return program + _answer(ERRNO | errno.EPERM)


def install(program: Iterable[Instruction]) -> None:
    """Put this thread, and all it starts, under a filter for good.

    Raises:
        OSError: the kernel refuses it.
    """
    code = b"".join(struct.pack("=HBBI", *instruction) for instruction in program)
    header = Program(len(code) // 8, code)
    prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, ctypes.byref(header))


def _judgments(pid: int, *, threads: bool) -> Mapping[str, list[Instruction]]:
    """Return what decides on each call that is judged by its arguments."""
    denied = _answer(ERRNO | errno.EPERM)
    thread = [*_low(0), *_allow_if(IF_ANY_BIT, (CLONE_THREAD,))] if threads else []
    options = (*NAME_CALLS, *READING_PRCTL, PR_SET_VMA)
    return {
        "open": _opening(1),
        "openat": _opening(2),
        "clone": thread + denied,
        # Its flags are in memory, which a filter cannot read: as if the kernel had none.
        "clone3": _answer(ERRNO | errno.ENOSYS),
        "kill": _signal_to_itself(pid, 1),
        "tkill": _signal_to_itself(pid, 1),
        "tgkill": _signal_to_itself(pid, 2),
        "madvise": [*_low(2), *_allow_if(IF_EQUAL, HARMLESS_MADVISE), *denied],
        "prctl": [*_low(0), *_allow_if(IF_EQUAL, options), *denied],
        "ioctl": [*_low(1), *_allow_if(IF_EQUAL, HARMLESS_IOCTL), *_answer(ERRNO | errno.ENOTTY)],
        "fcntl": [*_low(1), *_allow_if(IF_EQUAL, HARMLESS_FCNTL), *denied],
        "prlimit64": _reading_prlimit(pid),
    }


def _opening(argument: int) -> list[Instruction]:
    """Allow to open a file as Landlock permits; the argument is the flags.

    Before its third version (Linux 6.2) Landlock does not see that ``O_TRUNC`` empties a file.
    With ``O_WRONLY`` and ``O_RDWR`` it asks for the right to write; otherwise it is denied here.
    """
    denied = _answer(ERRNO | errno.EPERM)
    return [
        *_low(argument),
        (AND, 0, 0, ACCESS_MODE),
        (IF_EQUAL, 0, 1, NEITHER_READ_NOR_WRITE),
        *denied,
        (IF_EQUAL, 0, 3, O_RDONLY),
        *_low(argument),
        (IF_ANY_BIT, 0, 1, O_TRUNC),
        *denied,
        *_answer(ALLOW),
    ]


def _signal_to_itself(pid: int, argument: int) -> list[Instruction]:
    """Allow a process to signal itself; the argument is the signal's."""
    denied = _answer(ERRNO | errno.EPERM)
    forbidden = [part for number in NOT_TO_ITSELF for part in ((IF_EQUAL, 0, 1, number), *denied)]
    return [*_low(argument), *forbidden, *_low(0), *_allow_if(IF_EQUAL, (pid,)), *denied]


def _reading_prlimit(pid: int) -> list[Instruction]:
    """Allow a process to ask for its own limits, with no pointer to new ones."""
    denied = _answer(ERRNO | errno.EPERM)
    return [
        *_low(0),
        (IF_EQUAL, 2, 0, 0),
        (IF_EQUAL, 1, 0, pid),
        *denied,
        *_low(2),
        (IF_EQUAL, 1, 0, 0),
        *denied,
        *_load(ARGUMENTS_AT + 8 * 2 + 4),
        (IF_EQUAL, 1, 0, 0),
        *denied,
        *_answer(ALLOW),
    ]


def _allow_if(test: int, values: Iterable[int]) -> list[Instruction]:
    return [part for value in values for part in ((test, 0, 1, value), *_answer(ALLOW))]


def _low(argument: int) -> list[Instruction]:
    """Load an argument's low half, all that the kernel takes of an ``int``; little-endian."""
    return _load(ARGUMENTS_AT + 8 * argument)


def _load(offset: int) -> list[Instruction]:
    return [(LOAD, 0, 0, offset)]


def _answer(action: int) -> list[Instruction]:
    return [(RETURN, 0, 0, action)]
