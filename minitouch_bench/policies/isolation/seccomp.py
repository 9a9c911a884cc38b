"""A seccomp filter for policies, written in classic BPF. See seccomp(2).

It is a list of what is allowed, because the kernel gains calls every year and a list of what
is forbidden would let each new one through. What is not on it answers EPERM, which Python
shows as PermissionError; what is younger than the list answers ENOSYS, on which the C library
falls back to older calls. Calls of another architecture, and x32's, have numbers that mean
something else, and nobody makes them by accident: they kill the process.
"""

import ctypes
import errno
import struct
from collections.abc import Iterable, Mapping

from minitouch_bench.policies.isolation.kernel import PR_SET_SECCOMP, prctl
from minitouch_bench.policies.isolation.syscalls import (
    ALLOWED,
    ARCHITECTURES,
    FIRST_UNKNOWN,
    JUDGED,
)

AUDIT_ARCH = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
X32_BIT = 0x40000000
SECCOMP_MODE_FILTER = 2

KILL_PROCESS = 0x80000000
ERRNO = 0x00050000
ALLOW = 0x7FFF0000

LOAD, RETURN = 0x20, 0x06
IF_EQUAL, IF_AT_LEAST, IF_ANY_BIT = 0x15, 0x35, 0x45
NUMBER_AT, ARCHITECTURE_AT, ARGUMENTS_AT = 0, 4, 16

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
    for name, block in _judgements(pid, threads=threads).items():
        number = JUDGED[name][column]
        assert number is not None
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


def _judgements(pid: int, *, threads: bool) -> Mapping[str, list[Instruction]]:
    """Return what decides on each call that is judged by its arguments."""
    denied = _answer(ERRNO | errno.EPERM)
    thread = [*_low(0), *_allow_if(IF_ANY_BIT, (CLONE_THREAD,))] if threads else []
    options = (*NAME_CALLS, *READING_PRCTL, PR_SET_VMA)
    return {
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


def _signal_to_itself(pid: int, argument: int) -> list[Instruction]:
    """Allow a process to signal itself; the argument is the signal's."""
    denied = _answer(ERRNO | errno.EPERM)
    forbidden = [part for one in NOT_TO_ITSELF for part in ((IF_EQUAL, 0, 1, one), *denied)]
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
