"""Own worker processes on pipes: they survive a crash inside CoACD and end with their parent.

``multiprocessing.Pool`` hangs after a worker's kill -9, and a process pool loses what was in
flight; here the one task of a dead worker is tried once more, then fails by name.
"""

import ctypes
import os
import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from minitouch_bench.arithmetic import same_arithmetic
from minitouch_bench.errors import InfrastructureError, MiniTouchError
from minitouch_bench.optional import look_up

_PR_SET_PDEATHSIG = 1


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    task: int | None = None


def map_in_workers(target: str, tasks: Sequence[Any], workers: int) -> Iterator[tuple[int, Any]]:
    """Yield (position, ``target(task)``) as tasks end, in any order.

    ``target`` is written ``package.module:function``; it is imported in the workers only.

    Raises:
        InfrastructureError: a worker died twice on one task, or its function raised.
    """
    waiting = list(range(len(tasks)))[::-1]
    died: set[int] = set()
    pool = [_start(target) for _ in range(min(workers, len(tasks)))]
    try:
        for worker in pool:
            _feed(worker, waiting, tasks)
        while any(worker.task is not None for worker in pool):
            ready = wait([w.pipe for w in pool if w.task is not None])
            for worker in [w for w in pool if w.pipe in ready]:
                position = worker.task
                assert position is not None
                try:
                    failure, result = worker.pipe.recv()
                except (EOFError, OSError):
                    if position in died:
                        raise InfrastructureError(
                            f"a worker died twice on task {position}"
                        ) from None
                    died.add(position)
                    waiting.append(position)
                    worker.process.join()
                    fresh = _start(target)
                    worker.process, worker.pipe = fresh.process, fresh.pipe
                    _feed(worker, waiting, tasks)
                    continue
                if failure:
                    raise InfrastructureError(failure)
                yield position, result
                _feed(worker, waiting, tasks)
    finally:
        for worker in pool:
            worker.pipe.close()
            worker.process.terminate()
            worker.process.join()


def _start(target: str) -> _Worker:
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(target, theirs, os.getpid()), daemon=True)
    with same_arithmetic():
        process.start()
    theirs.close()
    return _Worker(process, ours)


def _feed(worker: _Worker, waiting: list[int], tasks: Sequence[Any]) -> None:
    worker.task = waiting.pop() if waiting else None
    if worker.task is not None:
        try:
            worker.pipe.send(tasks[worker.task])
        except OSError:  # died while idle: the next read finds out, and tries again
            return


def _serve(target: str, pipe: Connection, parent: int) -> None:
    """Answer tasks until the pipe closes or the parent dies."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if os.getppid() != parent:
        return
    function = look_up(target)
    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            answer = ("", function(task))
        except MiniTouchError as error:
            answer = (str(error), None)
        except Exception as error:  # reported by name in the parent
            answer = (f"{type(error).__name__}: {error}", None)
        pipe.send(answer)
