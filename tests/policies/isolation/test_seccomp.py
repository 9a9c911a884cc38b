"""The filter, run instruction by instruction, as the kernel would."""

import errno
import os
import struct

import pytest

from minitouch_bench.policies import kernel
from minitouch_bench.policies.kernel import ALLOWED, JUDGED

PID = 4321
DENIED = kernel.ERRNO | errno.EPERM
ABSENT = kernel.ERRNO | errno.ENOSYS
FORBIDDEN = {
    "socket": 41, "connect": 42, "execve": 59, "execveat": 322, "ptrace": 101,
    "process_vm_readv": 310, "process_vm_writev": 311, "io_uring_setup": 425, "bpf": 321,
    "perf_event_open": 298, "keyctl": 250, "add_key": 248, "mount": 165, "umount2": 166,
    "pivot_root": 155, "chroot": 161, "unshare": 272, "setns": 308, "userfaultfd": 323,
    "memfd_create": 319, "personality": 135, "pidfd_send_signal": 424, "pidfd_open": 434,
    "pidfd_getfd": 438, "rt_sigqueueinfo": 129, "shmget": 29, "semget": 64, "msgget": 68,
    "setpriority": 140, "sched_setaffinity": 203, "setpgid": 109, "fchmod": 91, "fchown": 93,
    "ftruncate": 77, "fallocate": 285, "unlinkat": 263, "mkdirat": 258, "setxattr": 188,
    "utimensat": 280, "seccomp": 317, "setuid": 105, "init_module": 175, "flock": 73,
    "mincore": 27, "fadvise64": 221, "rt_tgsigqueueinfo": 297,
}  # fmt: skip


def decide(program, number, arguments=(), architecture=kernel.AUDIT_ARCH):
    """Return the filter's answer to a call."""
    padded = [value % 2**64 for value in (*arguments, 0, 0, 0, 0, 0, 0)[:6]]
    data = struct.pack("<IIQ6Q", number, architecture, 0, *padded)
    accumulator, at = 0, 0
    while True:
        code, if_true, if_false, constant = program[at]
        if code == kernel.RETURN:
            return constant
        if code == kernel.LOAD:
            (accumulator,) = struct.unpack_from("<I", data, constant)
            at += 1
            continue
        if code == kernel.AND:
            accumulator &= constant
            at += 1
            continue
        holds = {
            kernel.IF_EQUAL: accumulator == constant,
            kernel.IF_AT_LEAST: accumulator >= constant,
            kernel.IF_ANY_BIT: bool(accumulator & constant),
        }[code]
        at += 1 + (if_true if holds else if_false)


PROGRAMS = {threads: kernel.make_filter(PID, threads=threads) for threads in (False, True)}
NUMBERS = {**ALLOWED, **JUDGED, **FORBIDDEN}


def judge(call, *arguments, threads=False, architecture=kernel.AUDIT_ARCH):
    number = NUMBERS[call] if isinstance(call, str) else call
    return decide(PROGRAMS[threads], number, arguments, architecture)


@pytest.mark.parametrize("threads", [False, True])
def test_what_computing_needs_is_allowed_and_what_reaches_beyond_the_process_denied(threads):
    assert {judge(name, threads=threads) for name in ALLOWED} == {kernel.ALLOW}
    assert {judge(name, threads=threads) for name in FORBIDDEN} == {DENIED}


THREAD, PROCESS = 0x3D0F00, 0x1200011
PRIVATE, SHARED, SHARED_VALIDATED = 0x22, 0x21, 0x03
CLOCKS = ("clock_gettime", "clock_getres", "clock_nanosleep")
SIGNALS = ("kill", "tkill", "tgkill")
OTHERS = (0, 1, -1, -PID, PID + 1)
FILE_FLAGS = (os.O_RDONLY | os.O_CLOEXEC, os.O_WRONLY | os.O_TRUNC, os.O_RDWR | os.O_TRUNC)
EMPTYING = (os.O_TRUNC, os.O_TRUNC | os.O_CLOEXEC, 3, 3 | os.O_TRUNC, os.O_TRUNC + 2**32)
ALLOWED_CALLS = [
    # To itself only; the kernel takes 32 bits, and so ours.
    *((name, pid, 6, 6) for name in SIGNALS for pid in (PID, PID + 2**32)),
    ("mmap", 0, 4096, 3, PRIVATE),
    *(("madvise", 0, 4096, advice) for advice in (4, 8, 14)),
    *(("openat", -100, 0, flags) for flags in FILE_FLAGS),
    *(("open", 0, flags) for flags in FILE_FLAGS),
    *((name, clock) for name in CLOCKS for clock in range(12)),
    ("prlimit64", 0, 7, 0, 1000),
    ("prlimit64", PID, 7, 0, 1000),
    ("prctl", 15),
    ("prctl", kernel.PR_SET_VMA),
    ("fcntl", 3, 2),
    ("fcntl", 3, 1030),
    ("ioctl", 0, 0x5401),
]
DENIED_CALLS = [
    *((name, pid, 6, 6) for name in SIGNALS for pid in OTHERS),
    # It cannot seem killed or stopped from outside.
    *((name, PID, number) for name in ("kill", "tkill") for number in (9, 19, 9 + 2**32)),
    *(("tgkill", PID, PID, number) for number in (9, 19, 9 + 2**32)),
    ("clone", THREAD),
    *(("mmap", 0, 4096, 3, flags) for flags in (SHARED, SHARED_VALIDATED)),
    *(("madvise", 0, 4096, advice) for advice in (3, 9, 12, 20, 21)),  # about others' memory
    *(("openat", -100, 0, flags) for flags in EMPTYING),
    *(("open", 0, flags) for flags in EMPTYING),
    *((name, ~pid << 3 | 2) for name in CLOCKS for pid in (0, 1, PID, PID + 1)),
    ("prlimit64", PID + 1, 7, 0, 1000),
    ("prlimit64", 0, 7, 1000, 0),
    ("prlimit64", 0, 7, 2**32, 0),
    *(("prctl", option) for option in (1, 4, 8, 22, 24, 38, 47, 1499557217)),
    *(("fcntl", 3, option) for option in (6, 8, 10, 15, 1024, 1026)),
    (425,),
]


@pytest.mark.parametrize(
    ("answer", "calls"), [(kernel.ALLOW, ALLOWED_CALLS), (DENIED, DENIED_CALLS)]
)
def test_a_call_is_judged_by_its_arguments(answer, calls):
    assert [call for call in calls if judge(*call) != answer] == []
    assert [JUDGED["open"], JUDGED["openat"]] == [2, 257]


def test_what_is_trusted_may_start_threads_and_share_memory_but_no_process():
    assert judge("clone", THREAD, threads=True) == kernel.ALLOW
    assert judge("clone", PROCESS, threads=True) == DENIED
    assert judge("mmap", 0, 4096, 3, SHARED, threads=True) == kernel.ALLOW


def test_what_is_absent_is_told_from_what_is_denied_and_calls_of_another_kind_kill():
    assert judge("clone3", threads=True) == judge(450) == judge(1000) == ABSENT
    assert judge("ioctl", 0, 0x5412) == kernel.ERRNO | errno.ENOTTY
    assert judge("read", architecture=0x40000003) == kernel.KILL_PROCESS  # i386
    assert judge("read", architecture=0xC0000015) == kernel.KILL_PROCESS  # ppc64le
    assert judge(kernel.X32_BIT, threads=True) == kernel.KILL_PROCESS
