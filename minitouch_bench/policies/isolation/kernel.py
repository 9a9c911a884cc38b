"""System calls that Python has no function for, through the C library."""

import ctypes
import os

PR_SET_SECCOMP = 22
PR_SET_NO_NEW_PRIVS = 38

LIBC = ctypes.CDLL(None, use_errno=True)


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
    return [ctypes.c_ulong(one) if isinstance(one, int) else one for one in arguments]


def _checked(answer: int) -> int:
    if answer < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return answer
