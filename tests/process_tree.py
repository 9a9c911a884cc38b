"""Processes of this Python, and those below another one as /proc shows them."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path


def run_python(*arguments: object, code=0, cwd=None, **variables) -> subprocess.CompletedProcess:
    """Run this Python with these variables too; what it wrote is shown where its exit code differs.

    ``cwd``: its working directory.
    """
    done = subprocess.run(
        [sys.executable, *map(str, arguments)], cwd=cwd, env={**os.environ, **variables},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stdout + done.stderr
    return done


WITHOUT_LOCKS = """
from minitouch_bench.policies import kernel
FLOCK = 73  # its number on x86-64
kernel.prctl(kernel.PR_SET_NO_NEW_PRIVS, 1)
kernel.install_filter([
    (kernel.LOAD, 0, 0, 0), (kernel.IF_EQUAL, 0, 1, FLOCK),
    (kernel.RETURN, 0, 0, kernel.ERRNO | int(sys.argv.pop(1))), (kernel.RETURN, 0, 0, kernel.ALLOW),
])
"""
"""Let the kernel answer each flock with the error number that is the first argument."""


def git(clone: Path, *words: str) -> str:
    identity = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    command = ["git", "-C", str(clone), *identity, *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def descendants(pid: int) -> set[int]:
    """Return the ids of all live descendants of a process."""
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        own = {int(word) for task in tasks for word in (task / "children").read_text().split()}
    except (FileNotFoundError, ProcessLookupError):
        return set()
    return own | {found for child in own for found in descendants(child)}


def command_line(pid: int) -> bytes:
    """Return the words of a process, nothing if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""


def is_alive(pid: int) -> bool:
    """Tell whether a process runs; one that waits for its parent's notice does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_until(holds: Callable[[], bool], seconds: float = 30.0) -> None:
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.005)
