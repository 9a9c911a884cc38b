"""A policy that tries to break out, one way an act, and tells what the kernel said.

``touch[0]`` picks the way. The action's first number is the error's number, 0 where it worked.
"""

import ctypes
import fcntl
import gc
import mmap
import os
import platform
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
HERE = Path(__file__).parent
MACHINE = platform.machine()
CANARY = HERE / "canary"


def call(number, *arguments):
    if LIBC.syscall(number, *arguments) < 0:
        raise OSError(ctypes.get_errno(), "refused")


def prctl(*arguments):
    if LIBC.prctl(*arguments) < 0:
        raise OSError(ctypes.get_errno(), "refused")


def fork():
    if os.fork() == 0:
        os._exit(0)


def read_parents_memory():
    with open(f"/proc/{os.getppid()}/mem", "rb") as file:
        file.seek(0x400000)
        file.read(1)


def peek():
    local = ctypes.create_string_buffer(8)
    vector = struct.pack("QQ", ctypes.addressof(local), 8)
    call(310, os.getppid(), vector, 1, vector, 1, 0)


def be_signalled_for(owner):
    fcntl.fcntl(0, fcntl.F_SETOWN, owner)


def find_descriptors():
    """Raise EMFILE if no more is open than the streams and one socket."""
    opened = []
    for number in range(4096):
        try:
            opened.append(os.fstat(number).st_mode)
        except OSError:
            continue
    if len(opened) == 4:
        raise OSError(24, "no more than there should be")


def find_simulator():
    """Look for a world, or for what runs the episodes, in all that this process holds."""
    names = {type(thing).__name__ for thing in gc.get_objects()}
    held = names & {"MiniTouchEnv", "BulletClient", "EpisodeRunner", "EpisodeSpec", "PolicyProcess"}
    if not held and "pybullet" not in sys.modules:
        raise OSError(2, "nothing here")


def find_secrets():
    LIBC.getenv.restype = ctypes.c_char_p
    if "MINITOUCH_SECRET" not in os.environ and LIBC.getenv(b"MINITOUCH_SECRET") is None:
        raise OSError(2, "nothing here")


def find_fatal_limit():
    """Look for a limit at which the kernel kills, as if from outside."""
    if resource.getrlimit(resource.RLIMIT_CPU)[1] == resource.RLIM_INFINITY:
        raise OSError(2, "nothing here")


def leave_flags():
    for stream in range(3):
        flags = fcntl.fcntl(stream, fcntl.F_GETFL)
        fcntl.fcntl(stream, fcntl.F_SETFL, flags | os.O_APPEND | os.O_NONBLOCK)


def find_flags():
    flags = [fcntl.fcntl(stream, fcntl.F_GETFL) for stream in range(3)]
    if not any(value & (os.O_APPEND | os.O_NONBLOCK) for value in flags):
        raise OSError(2, "nothing here")


def x32_call():
    call(0x40000000 + 39)


DEEDS = {
    "open a socket": socket.socket,
    "fork": fork,
    "exec": lambda: os.execv(sys.executable, ["python", "-c", ""]),
    "kill its parent": lambda: os.kill(os.getppid(), signal.SIGKILL),
    "signal everything": lambda: os.kill(-1, 0),  # the filter judges the target alone
    "kill itself": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "find a limit that kills": find_fatal_limit,
    "see what is in memory of a file": lambda: call(27, 0, 4096, b"x"),
    "have a file forgotten": lambda: os.posix_fadvise(0, 0, 0, os.POSIX_FADV_DONTNEED),
    "have its parent signalled": lambda: be_signalled_for(os.getppid()),
    "signal by descriptor": lambda: signal.pidfd_send_signal(0, 9),
    "trace its parent": lambda: call(101, 16, os.getppid(), 0, 0),
    "peek into its parent": peek,
    "read its parent's memory": read_parents_memory,
    "read its parent's environment": lambda: Path(f"/proc/{os.getppid()}/environ").read_bytes(),
    "read its own environment": lambda: Path("/proc/self/environ").read_bytes(),
    "read its parent's processor time": lambda: time.clock_gettime(~os.getppid() << 3 | 2),
    "list processes": lambda: os.listdir("/proc"),
    "write a file": lambda: Path(CANARY).write_text("x"),
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
    "use io_uring": lambda: call(425, 4, ctypes.create_string_buffer(120)),
    "load a BPF program": lambda: call(321, 0, None, 0),
    "watch performance": lambda: call(298, None, 0, -1, -1, 0),
    "keep a key": lambda: call(248, b"user", b"a", b"b", 1, -3),
    "handle page faults": lambda: call(323, 0),
    "mount": lambda: call(165, None, None, None, 0, None),
    "unshare": lambda: call(272, 0x10000000),
    "enter another namespace": lambda: call(308, 0, 0),
    "change personality": lambda: call(135, 0x0040000),
    "outlive its parent": lambda: prctl(1, 0, 0, 0, 0),
    "leave its group": lambda: os.setpgid(0, 0),
    "slow others down": lambda: os.setpriority(os.PRIO_PROCESS, os.getppid(), 19),
    "limit its parent": lambda: resource.prlimit(os.getppid(), resource.RLIMIT_CPU, (1, 1)),
    "raise its own limits": lambda: resource.setrlimit(resource.RLIMIT_AS, (-1, -1)),
    "allocate 10 GB": lambda: mmap.mmap(-1, 10 * 10**9),
    "use clone3": lambda: call(435, None, 0),
    "use a call of the future": lambda: call(600),
    "type into a terminal": lambda: fcntl.ioctl(0, 0x5412, b"x"),
}
FATAL = {"x32": x32_call}
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
            deed()
        except OSError as error:
            return np.array([error.errno, 0, 0, 0], np.float32)
        except ValueError:  # what Python makes of EPERM from setrlimit
            return np.array([1, 0, 0, 0], np.float32)
        return np.zeros(4, np.float32)
