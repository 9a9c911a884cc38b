"""Worker processes: all compute alike, none outlives its parent, and one that dies is replaced.

``multiprocessing.Pool`` hangs after a worker's kill -9, and ``ProcessPoolExecutor`` loses all
that was in flight. Here the job of a dead worker is tried again. Their workers also import the
program's main module, which a script without a guard would not survive.
"""

import contextlib
import ctypes
import math
import os
import pickle
import platform
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from importlib.metadata import version
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Generic, TypeVar

import cloudpickle

from minitouch_bench.errors import InfrastructureError, MiniTouchError

ARITHMETIC = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Environment under which numpy, OpenBLAS, torch and oneDNN round alike on all x86-64 processors.

They choose other kernels on another processor, whose sums and sines differ in the last bits.
A process started with these variables keeps to one thread and, on x86-64, to AVX2; MKL ignores
its own on AMD. The libraries read them when they are loaded.
"""
if platform.machine() == "x86_64":
    NUMPY = tuple(int(part) for part in version("numpy").split(".")[:2])
    ARITHMETIC |= {
        # The name of AVX-512's first part; without it numpy uses none of the others.
        "NPY_DISABLE_CPU_FEATURES": "X86_V4" if NUMPY >= (2, 4) else "AVX512F",
        "OPENBLAS_CORETYPE": "Haswell",
        "ATEN_CPU_CAPABILITY": "avx2",
        "ONEDNN_MAX_CPU_ISA": "AVX2",
        "MKL_CBWR": "AVX2",
    }

START = """
import sys
from multiprocessing.connection import Connection
connection = Connection(int(sys.argv[1]))
try:
    sys.path[:] = connection.recv()
except (EOFError, OSError):  # the parent ended before its first message
    sys.exit()
from minitouch_bench.processes import serve_jobs
serve_jobs(connection, int(sys.argv[2]))
"""
"""The program of a worker: what it imports comes from where its parent has it."""

CLOSE_TIMEOUT_S = 2.0
PR_SET_PDEATHSIG = 1
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3

MAX_ATTEMPTS = 3
"""A job, such as an episode, that fails for no fault of the user is tried again, twice."""

Job = TypeVar("Job")
Result = TypeVar("Result")


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back until the block ends; a process that the block starts never sees one.

    A terminal sends it to every process of a run, and the parent alone decides what it means.
    """
    came: list[int] = []
    is_main = threading.current_thread() is threading.main_thread()
    if is_main:
        handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited, unlike a handler
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if is_main:
            signal.signal(signal.SIGINT, handler)
    if came:
        signal.raise_signal(signal.SIGINT)


def die_with(parent: int) -> None:
    """Have the kernel kill this process when its parent ends, or end now if it has.

    The parent is the thread that started the process: start it in a lasting one. Only Linux can
    do it; elsewhere a process ends when the pipe that it reads from does.
    """
    if platform.system() == "Linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before the request was made
        os._exit(0)


def keep_freed_memory() -> None:
    """Have the C library keep freed memory for what needs it next, where it is glibc.

    It would return large tensors to the system, and each new one would start with page faults.
    """
    if platform.libc_ver()[0] == "glibc":
        library = ctypes.CDLL(None)
        library.mallopt(M_MMAP_THRESHOLD, 2**25)  # the largest that it takes
        library.mallopt(M_TRIM_THRESHOLD, 2**30)


def core_count() -> int:
    """Return how many cores this process may use, at least 1: by its affinity and its quota."""
    has_affinity = hasattr(os, "sched_getaffinity")  # not on macOS
    cores = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    return max(1, math.ceil(min(cores, cpu_quota())))


def cpu_quota(root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")) -> float:
    """Return the smallest CPU quota of this process's control groups (version 2), in cores.

    The limit of a container, as of ``docker --cpus``, is such a quota; its affinity has all cores.
    Infinite where there is no quota.
    """
    quotas = [math.inf]
    with contextlib.suppress(OSError):
        group = next((x[3:] for x in own.read_text().splitlines() if x.startswith("0::")), "/")
        for folder in ((path := root / group.strip("/")), *path.parents):
            with contextlib.suppress(OSError, ValueError):  # "max" is no number
                quota, period = map(float, (folder / "cpu.max").read_text().split())
                quotas.append(quota / period)
    return min(quotas)


def run_in_workers(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: int,
    *,
    name: Callable[[Job], str],
    ended: Callable[[str], Result] | None = None,
) -> Generator[tuple[int, Result], None, None]:
    """Yield (index, ``function(job)``) as jobs end, from ``workers`` processes.

    The function is copied to each worker once, and keeps there what it remembers. A job whose
    worker dies, or whose function raises, is tried again in a new process. An error that is
    the user's passes through at once: any ``MiniTouchError`` but an ``InfrastructureError``.
    ``name`` says in an error which job failed. ``ended`` makes a result of what is known where
    the job's worker died each time, so that the other jobs go on.

    Raises:
        InfrastructureError: a job failed three times, or no worker can be started.
    """
    waiting = deque((index, 1) for index in range(len(jobs)))
    pool: list[_Worker[Job, Result]] = []
    try:
        while waiting or any(worker.task for worker in pool):
            while len(pool) < min(workers, len(jobs)):
                pool.append(_Worker(function))
            for worker in pool:
                if worker.task is None and waiting:
                    worker.task = waiting.popleft()
                    worker.send(jobs[worker.task[0]])
            for worker in _ready(pool):
                assert worker.task is not None
                (index, attempt), worker.task = worker.task, None
                result = worker.receive()
                if not isinstance(result, MiniTouchError):
                    yield index, result
                    continue
                if not isinstance(result, InfrastructureError):
                    raise result
                is_dead = worker.process.returncode is not None
                pool.remove(worker)
                worker.close()
                text = f"failed {MAX_ATTEMPTS} times: {result}"
                if attempt < MAX_ATTEMPTS:
                    waiting.appendleft((index, attempt + 1))
                elif is_dead and ended:
                    yield index, ended(text)
                else:
                    raise InfrastructureError(f"{name(jobs[index])} {text}")
    finally:
        for worker in pool:
            worker.close()


class _Worker(Generic[Job, Result]):
    """The parent's side of one worker process; ``task`` is (index of its job, attempt)."""

    def __init__(self, function: Callable[[Job], Result]) -> None:
        self.task: tuple[int, int] | None = None
        try:
            self.connection, theirs = Pipe()
            command = [sys.executable, "-P", "-c", START, str(theirs.fileno()), str(os.getpid())]
            with theirs, interrupts_held():
                self.process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=2,  # as standard error: standard output is for the parent's results
                    pass_fds=(theirs.fileno(),),
                    env={**os.environ, **ARITHMETIC},
                )
        except (OSError, RuntimeError) as error:  # too many files or threads, or no memory
            raise InfrastructureError(f"no worker can be started: {error}") from error
        self.send(sys.path)
        self.send(cloudpickle.dumps(function))

    def send(self, message: object) -> None:
        """Hand over a job; a worker that has died is found by the end of its pipe."""
        with contextlib.suppress(OSError):
            self.connection.send(message)

    def receive(self) -> Result | MiniTouchError:
        """Return what came of the job, or the error that it ended with."""
        with contextlib.suppress(EOFError, OSError):
            return self.connection.recv()
        return InfrastructureError(f"its worker ended (exit code {self._wait()})")

    def close(self) -> None:
        """End the process; what it was doing is lost."""
        self.connection.close()
        self.process.kill()
        self._wait()

    def _wait(self) -> int | None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(CLOSE_TIMEOUT_S)
        return self.process.returncode


def _ready(pool: Sequence[_Worker[Job, Result]]) -> list[_Worker[Job, Result]]:
    """Wait until some busy workers have an answer or have died, and return them.

    The pipe of a worker that has died is at its end: no other process has the worker's side.
    """
    busy = [worker for worker in pool if worker.task]
    ready = wait([worker.connection for worker in busy])
    return [worker for worker in busy if worker.connection in ready]


def serve_jobs(connection: Connection, parent: int) -> None:
    """Run in a worker process: answer each job received, until the pipe closes."""
    die_with(parent)
    with contextlib.suppress(EOFError, OSError):
        function: Callable[[Any], Any] = pickle.loads(connection.recv())
        while True:
            job = connection.recv()
            try:
                answer = function(job)
            except MiniTouchError as error:
                answer = error
            except Exception as error:
                answer = InfrastructureError(f"{type(error).__name__}: {error}")
            connection.send(answer)
