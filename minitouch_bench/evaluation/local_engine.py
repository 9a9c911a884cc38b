"""Episodes and other jobs on this machine, in worker processes."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.evaluation.engine import Engine, EngineOptions, Job, Note
from minitouch_bench.evaluation.rollout import ActorSource, EpisodeRunner
from minitouch_bench.processes import ONE_THREAD, core_count, run_in_workers
from minitouch_bench.records import EpisodeRecord, EpisodeSpec


def open_engine(
    options: EngineOptions,
    note: Note,  # noqa: ARG001 - an opener's signature
) -> contextlib.AbstractContextManager[Engine]:
    """Open the engine of this machine."""
    return contextlib.nullcontext(LocalEngine(options.workers or core_count()))


class LocalEngine:
    """Runs each episode in one of ``workers`` processes."""

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(self, source: ActorSource, specs: Sequence[EpisodeSpec]) -> Iterator[EpisodeRecord]:
        """Yield records as episodes end; a worker that dies is replaced, its episode retried.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy.
        """
        records = run_in_workers(
            partial(_run_episode, EpisodeRunner(source)),
            specs,
            self.workers,
            name=lambda spec: f"episode {spec.key}",
        )
        with contextlib.closing(records):
            for _, record in records:
                yield record


def _run_episode(runner: EpisodeRunner, spec: EpisodeSpec) -> EpisodeRecord:
    """Run an episode in a worker. A policy's fault is a record: any error is the machine's."""
    try:
        return runner.run(spec)
    except InfrastructureError:
        raise
    except Exception as error:
        raise InfrastructureError(f"{type(error).__name__}: {error}") from error


def run_jobs(
    options: EngineOptions, function: Callable[[Job], str], jobs: Sequence[Job]
) -> Iterator[tuple[Job, str]]:
    """Run jobs in worker processes; one whose worker died three times has failed.

    The jobs are trainings, and use all that the processor has: with the kernels of ``ARITHMETIC``
    a control step of ``icm`` took 108 ms in place of 25 where the processor computes in bfloat16.
    """
    ended = run_in_workers(
        function,
        jobs,
        options.workers or core_count(),
        name=str,
        failed=str,
        variables=ONE_THREAD,
    )
    with contextlib.closing(ended):
        for index, failure in ended:
            yield jobs[index], failure
