"""A policy that tries to break out, one way an act, and tells what the kernel said.

``touch[0]`` picks the way. The action's first number is the error's number, 0 where it worked;
what looks for something returns False where nothing is.
"""

import contextlib
import ctypes
import errno
import fcntl
import gc
import mmap
import os
import resource
import signal
import socket
import struct
import sys
import threading
import time
from pathlib import Path

import numpy as np

LIBC = ctypes.CDLL(None, use_errno=True)
LIBC.getenv.restype = ctypes.c_char_p
CANARY = Path(__file__).with_name("canary")


def call(number, *arguments):
    if LIBC.syscall(number, *arguments) < 0:
        raise OSError(ctypes.get_errno(), "refused")


def read_parents_memory():
    with open(f"/proc/{os.getppid()}/mem", "rb") as file:
        file.seek(0x400000)
        file.read(1)


def peek():
    local = ctypes.create_string_buffer(8)
    vector = struct.pack("QQ", ctypes.addressof(local), 8)
    call(310, os.getppid(), vector, 1, vector, 1, 0)


def find_descriptors():
    """Tell whether other descriptors are open than the streams and one socket."""
    opened = 0
    for number in range(4096):
        with contextlib.suppress(OSError):
            os.fstat(number)
            opened += 1
    return opened != 4


def find_simulator():
    """Look for a world, or for what runs the episodes, in all that this process holds."""
    names = {type(thing).__name__ for thing in gc.get_objects()}
    held = names & {"MiniTouchEnv", "BulletClient", "EpisodeRunner", "EpisodeSpec", "PolicyProcess"}
    return bool(held) or "pybullet" in sys.modules


def find_secrets():
    return "MINITOUCH_SECRET" in os.environ or LIBC.getenv(b"MINITOUCH_SECRET") is not None


def find_fatal_limit():
    """Look for a limit at which the kernel kills, as if from outside."""
    return resource.getrlimit(resource.RLIMIT_CPU)[1] != resource.RLIM_INFINITY


def leave_flags():
    for stream in range(3):
        flags = fcntl.fcntl(stream, fcntl.F_GETFL)
        fcntl.fcntl(stream, fcntl.F_SETFL, flags | os.O_APPEND | os.O_NONBLOCK)


def find_flags():
    flags = [fcntl.fcntl(stream, fcntl.F_GETFL) for stream in range(3)]
    return any(value & (os.O_APPEND | os.O_NONBLOCK) for value in flags)


DEEDS = {
    "open a socket": socket.socket,
    "fork": lambda: os.fork() or os._exit(0),
    "exec": lambda: os.execv(sys.executable, ["python", "-c", ""]),
    "kill its parent": lambda: os.kill(os.getppid(), signal.SIGKILL),
    "signal everything": lambda: os.kill(-1, 0),  # the filter judges the target alone
    "kill itself": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "find a limit that kills": find_fatal_limit,
    "see what is in memory of a file": lambda: call(27, 0, 4096, b"x"),
    "have a file forgotten": lambda: os.posix_fadvise(0, 0, 0, os.POSIX_FADV_DONTNEED),
    "have its parent signalled": lambda: fcntl.fcntl(0, fcntl.F_SETOWN, os.getppid()),
    "signal by descriptor": lambda: signal.pidfd_send_signal(0, 9),
    "trace its parent": lambda: call(101, 16, os.getppid(), 0, 0),
    "peek into its parent": peek,
    "read its parent's memory": read_parents_memory,
    "read its parent's environment": lambda: Path(f"/proc/{os.getppid()}/environ").read_bytes(),
    "read its own environment": lambda: Path("/proc/self/environ").read_bytes(),
    "read its parent's processor time": lambda: time.clock_gettime(~os.getppid() << 3 | 2),
    "list processes": lambda: os.listdir("/proc"),
    "write a file": lambda: CANARY.write_text("x"),
    "change its code's rights": lambda: os.chmod(__file__, 0o777),
    "make a folder": lambda: os.mkdir(CANARY),
    "remove its code": lambda: os.unlink(__file__),
    "read /etc/passwd": lambda: Path("/etc/passwd").read_bytes(),
    "list the root folder": lambda: os.listdir("/"),
    "find open descriptors": find_descriptors,
    "find the simulator": find_simulator,
    "find secrets": find_secrets,
    "attach a world in shared memory": lambda: call(29, 12347, 4096, 0o1000),
    "make a file in memory": lambda: os.memfd_create("x"),
    "lock a file for others": lambda: fcntl.flock(0, fcntl.LOCK_EX),
    "outlive its parent": lambda: call(157, 1, 0, 0, 0, 0),
    "leave its group": lambda: os.setpgid(0, 0),
    "slow others down": lambda: os.setpriority(os.PRIO_PROCESS, os.getppid(), 19),
    "limit its parent": lambda: resource.prlimit(os.getppid(), resource.RLIMIT_CPU, (1, 1)),
    "raise its own limits": lambda: resource.setrlimit(resource.RLIMIT_AS, (-1, -1)),
    "allocate 10 GB": lambda: mmap.mmap(-1, 10 * 10**9),
    "use clone3": lambda: call(435, None, 0),
    "use a call of the future": lambda: call(600),
    "type into a terminal": lambda: fcntl.ioctl(0, 0x5412, b"x"),
}
FATAL = {"x32": lambda: call(0x40000000 + 39)}
HARMLESS = {
    "read its own code": lambda: Path(__file__).read_bytes(),
    "import a package": lambda: __import__("wave"),
    "throw away output": lambda: Path(os.devnull).write_text("x"),
    "start a thread": lambda: threading.Thread(target=int).start(),
}
MEMORY = {"leave flags": leave_flags, "find flags": find_flags}
ALL = {**DEEDS, **FATAL, **HARMLESS, **MEMORY}


class Hostile:
    def reset(self, seed, task):
        pass

    def act(self, observation):
        deed = list(ALL.values())[int(observation["touch"][0])]
        try:
            number = errno.ENOENT if deed() is False else 0
        except OSError as error:
            number = error.errno
        except ValueError:  # what Python makes of EPERM from setrlimit
            number = errno.EPERM
        return np.array([number, 0, 0, 0], np.float32)
