"""Landlock: which files a process can reach. See landlock(7) and linux/landlock.h."""

import contextlib
import ctypes
import errno
import os
from collections.abc import Iterable

from minitouch_bench.policies.isolation.kernel import system_call

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
