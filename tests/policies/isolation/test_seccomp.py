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


def test_what_computing_needs_is_allowed():
    assert {judge(name) for name in ALLOWED} == {kernel.ALLOW}


@pytest.mark.parametrize("name", FORBIDDEN)
def test_what_reaches_beyond_the_process_is_denied(name):
    assert judge(name) == DENIED


def test_threads_only_where_they_are_asked_for_and_processes_never():
    thread, process = 0x3D0F00, 0x1200011
    assert judge("clone", thread) == DENIED
    assert judge("clone", thread, threads=True) == kernel.ALLOW
    assert judge("clone", process, threads=True) == DENIED
    assert judge("clone3", threads=True) == ABSENT


@pytest.mark.parametrize("name", ["kill", "tkill", "tgkill"])
def test_signals_go_to_oneself_only(name):
    assert judge(name, PID, 6, 6) == kernel.ALLOW
    assert judge(name, PID + 2**32, 6, 6) == kernel.ALLOW  # the kernel takes 32 bits, and so ours
    for other in (0, 1, -1, -PID, PID + 1):
        assert judge(name, other, 6, 6) == DENIED


@pytest.mark.parametrize("name", ["kill", "tkill", "tgkill"])
def test_a_policy_cannot_seem_killed_or_stopped(name):
    for number in (9, 19, 9 + 2**32):
        arguments = (PID, number) if name == "tgkill" else (number,)
        assert judge(name, PID, *arguments) == DENIED


def test_memory_is_shared_only_by_what_is_trusted():
    private, shared, shared_validated = 0x22, 0x21, 0x03
    assert judge("mmap", 0, 4096, 3, private) == kernel.ALLOW
    assert {judge("mmap", 0, 4096, 3, flags) for flags in (shared, shared_validated)} == {DENIED}
    assert judge("mmap", 0, 4096, 3, shared, threads=True) == kernel.ALLOW


def test_advice_is_about_its_own_memory_only():
    assert {judge("madvise", 0, 4096, advice) for advice in (4, 8, 14)} == {kernel.ALLOW}
    assert {judge("madvise", 0, 4096, advice) for advice in (3, 9, 12, 20, 21)} == {DENIED}


def test_no_file_is_emptied_that_landlock_does_not_let_write():
    for flags in (os.O_RDONLY | os.O_CLOEXEC, os.O_WRONLY | os.O_TRUNC, os.O_RDWR | os.O_TRUNC):
        assert judge("openat", -100, 0, flags) == kernel.ALLOW
        assert judge("open", 0, flags) == kernel.ALLOW
    for flags in (os.O_TRUNC, os.O_TRUNC | os.O_CLOEXEC, 3, 3 | os.O_TRUNC, os.O_TRUNC + 2**32):
        assert judge("openat", -100, 0, flags) == DENIED
        assert judge("open", 0, flags) == DENIED
    assert [JUDGED["open"], JUDGED["openat"]] == [2, 257]


@pytest.mark.parametrize("name", ["clock_gettime", "clock_getres", "clock_nanosleep"])
def test_only_clocks_that_tell_of_no_other_process_are_read(name):
    assert {judge(name, clock) for clock in range(12)} == {kernel.ALLOW}
    for pid in (0, 1, PID, PID + 1):
        assert judge(name, ~pid << 3 | 2) == DENIED


def test_limits_are_read_and_never_set():
    assert judge("prlimit64", 0, 7, 0, 1000) == kernel.ALLOW
    assert judge("prlimit64", PID, 7, 0, 1000) == kernel.ALLOW
    assert judge("prlimit64", PID + 1, 7, 0, 1000) == DENIED
    assert judge("prlimit64", 0, 7, 1000, 0) == DENIED
    assert judge("prlimit64", 0, 7, 2**32, 0) == DENIED


def test_options_that_reach_others_are_denied():
    assert judge("prctl", 15) == judge("prctl", kernel.PR_SET_VMA) == kernel.ALLOW
    assert {judge("prctl", option) for option in (1, 4, 8, 22, 24, 38, 47, 1499557217)} == {DENIED}
    assert judge("fcntl", 3, 2) == judge("fcntl", 3, 1030) == kernel.ALLOW
    assert {judge("fcntl", 3, option) for option in (6, 8, 10, 15, 1024, 1026)} == {DENIED}
    assert judge("ioctl", 0, 0x5401) == kernel.ALLOW
    assert judge("ioctl", 0, 0x5412) == kernel.ERRNO | errno.ENOTTY


def test_calls_of_another_kind_kill():
    assert judge("read", architecture=0x40000003) == kernel.KILL_PROCESS  # i386
    assert judge("read", architecture=0xC0000015) == kernel.KILL_PROCESS  # ppc64le
    assert judge(kernel.X32_BIT, threads=True) == kernel.KILL_PROCESS


def test_calls_of_the_future_are_absent():
    assert judge(450) == judge(1000) == ABSENT
    assert judge(425) == DENIED
