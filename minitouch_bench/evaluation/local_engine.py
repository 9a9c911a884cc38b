"""Episodes on this machine: worker processes that are watched, replaced and never outlive us."""

import contextlib
import ctypes
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from minitouch_bench.arithmetic import same_arithmetic
from minitouch_bench.errors import InfrastructureError, UsageError
from minitouch_bench.evaluation.engine import EngineHandle, EngineOptions, Note, core_count
from minitouch_bench.evaluation.rollout import MAX_ATTEMPTS, ActorSource, EpisodeRunner
from minitouch_bench.records import EpisodeRecord, EpisodeSpec

PR_SET_PDEATHSIG = 1
CLOSE_TIMEOUT_S = 2.0


def open_local(
    options: EngineOptions,
    note: Note,  # noqa: ARG001 - an opener's signature
) -> contextlib.AbstractContextManager[EngineHandle]:
    """Open the engine of this machine: see ``engine.ENGINES``."""
    if options.address is not None:
        raise UsageError("--address is a Ray cluster's: add --engine ray")
    workers = options.workers or core_count()
    return contextlib.nullcontext(EngineHandle(LocalEngine(workers), workers))


class LocalEngine:
    """Runs each episode in one of ``workers`` processes."""

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def run(self, source: ActorSource, specs: Sequence[EpisodeSpec]) -> Iterator[EpisodeRecord]:
        """Yield records as episodes end; a worker that dies is replaced, its episode retried.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy.
        """
        waiting = deque((spec, 1) for spec in specs)
        crew = [_Worker(source) for _ in range(min(self._workers, len(specs)))]
        try:
            while waiting or any(worker.job for worker in crew):
                for worker in crew:
                    if worker.job is None and waiting:
                        worker.start(*waiting.popleft())
                for worker in _ready(crew):
                    assert worker.job is not None
                    spec, attempt = worker.job
                    result = worker.result()
                    if isinstance(result, EpisodeRecord):
                        yield result
                        continue
                    if attempt == MAX_ATTEMPTS:
                        raise InfrastructureError(f"episode {spec.key} failed 3 times: {result}")
                    waiting.appendleft((spec, attempt + 1))
                    crew[crew.index(worker)] = _Worker(source)
                    worker.close()
        finally:
            for worker in crew:
                worker.close()


class _Worker:
    """The parent's side of one worker process."""

    def __init__(self, source: ActorSource) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: BaseProcess = context.Process(
            target=_serve, args=(theirs, source, os.getpid()), daemon=True
        )
        with _interrupts_held(), same_arithmetic():
            self.process.start()
        theirs.close()
        self.job: tuple[EpisodeSpec, int] | None = None

    def start(self, spec: EpisodeSpec, attempt: int) -> None:
        """Hand over an episode."""
        self.job = (spec, attempt)
        # A worker that has died is found by its sentinel.
        with contextlib.suppress(OSError):
            self.connection.send(spec)

    def result(self) -> EpisodeRecord | str:
        """Return the record, or what went wrong in words."""
        self.job = None
        try:
            result: EpisodeRecord | str = self.connection.recv()
        except (EOFError, OSError):
            self.process.join(CLOSE_TIMEOUT_S)
            return f"its worker ended (exit code {self.process.exitcode})"
        return result

    def close(self) -> None:
        """End the process; what it was doing is lost."""
        self.connection.close()
        self.process.kill()
        self.process.join(CLOSE_TIMEOUT_S)


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back: what starts meanwhile never sees it, this process does afterwards.

    It reaches the whole terminal, and the parent alone decides what it means.
    """
    resource_tracker.ensure_running()  # its start, else part of the first worker's, lifts the block
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _ready(crew: Sequence[_Worker]) -> list[_Worker]:
    """Wait until some busy workers have an answer or have died, and return them."""
    busy = [worker for worker in crew if worker.job]
    found = wait([handle for w in busy for handle in (w.connection, w.process.sentinel)])
    return [w for w in busy if w.connection in found or w.process.sentinel in found]


def _serve(connection: Connection, source: ActorSource, parent: int) -> None:
    """Run in a worker process: one episode for each spec received, until the pipe closes."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        return
    runner = EpisodeRunner(source)
    try:
        while True:
            spec = connection.recv()
            try:
                connection.send(runner.run(spec))
            except Exception as error:
                connection.send(f"{type(error).__name__}: {error}")
    except (EOFError, OSError):
        pass
    finally:
        runner.close()
