"""Episodes and other jobs on a Ray cluster, which finds room for them."""

from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from types import ModuleType
from typing import Any

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.evaluation.engine import Engine, EngineOptions, Job, Note
from minitouch_bench.evaluation.ray_cluster import check_address, ray_cluster
from minitouch_bench.evaluation.ray_pool import FailedAttempt, RayPool
from minitouch_bench.evaluation.remote_worker import pack
from minitouch_bench.evaluation.rollout import ActorSource
from minitouch_bench.processes import MAX_ATTEMPTS, ONE_THREAD
from minitouch_bench.records import EpisodeRecord, EpisodeSpec


def open_engine(options: EngineOptions, note: Note) -> AbstractContextManager[Engine]:
    """Open an engine on a Ray cluster."""
    if options.address is not None:
        check_address(options.address)
    return _joined(options, note)


@contextmanager
def _joined(options: EngineOptions, note: Note) -> Iterator[Engine]:
    # A Ray started here has one CPU per core, and a cluster the CPUs that it has.
    with ray_cluster(options.address, options.workers) as ray:
        yield RayEngine(ray, options.workers, note)


class RayEngine:
    """Runs each episode in a Ray actor that has one CPU of the cluster.

    ``ray`` is the module, connected to a cluster. There are at most ``workers`` actors, by
    default one for each CPU that the cluster has at the time. ``note`` takes a line about a
    node that is refused, lost, or another machine than this one.
    """

    def __init__(
        self, ray: ModuleType, workers: int | None, note: Callable[[str], None] = lambda _: None
    ) -> None:
        self._ray = ray
        self._workers = workers
        self._note = note

    @property
    def workers(self) -> int:
        """How many episodes the cluster as it is can run at a time."""
        cpus = int(self._ray.cluster_resources().get("CPU", 0))
        return max(1, cpus if self._workers is None else min(cpus, self._workers))

    def run(self, source: ActorSource, specs: Sequence[EpisodeSpec]) -> Iterator[EpisodeRecord]:
        """Yield records as episodes end; what a lost worker was doing goes to another one.

        A node that is lost takes nothing from an episode's three attempts.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy, or
                no node of the cluster can run any.
        """
        waiting = deque(specs)
        failed: defaultdict[EpisodeSpec, list[FailedAttempt]] = defaultdict(list)
        pool = RayPool(self._ray, pack(source), self._workers, self._note)
        try:
            while waiting or pool.is_busy():
                pool.add_workers(len(waiting))
                pool.assign(waiting)
                for spec, result in pool.results():
                    if isinstance(result, EpisodeRecord):
                        yield result
                        continue
                    failed[spec].append(result)
                    if pool.count_attempts(failed[spec]) >= MAX_ATTEMPTS:
                        raise InfrastructureError(
                            f"episode {spec.key} failed {MAX_ATTEMPTS} times: {result.reason}"
                        )
                    waiting.appendleft(spec)
        finally:
            pool.close()


def run_jobs(
    options: EngineOptions, function: Callable[[Job], str], jobs: Sequence[Job]
) -> Iterator[tuple[Job, str]]:
    """Run jobs where Ray finds room, ``workers`` at a time; one that failed three times failed."""
    settings = {
        "num_cpus": 1,
        "max_retries": MAX_ATTEMPTS - 1,
        "retry_exceptions": True,
        "runtime_env": {"env_vars": ONE_THREAD},
    }
    with ray_cluster(options.address, options.workers) as ray:
        run = ray.remote(**settings)(function)
        waiting, running = deque(jobs), dict[Any, Job]()
        while waiting or running:
            while waiting and len(running) < (options.workers or len(jobs)):
                job = waiting.popleft()
                running[run.remote(job)] = job
            (ended,), _ = ray.wait([*running])
            job = running.pop(ended)
            try:
                yield job, ray.get(ended)
            except ray.exceptions.RayTaskError as error:
                yield job, f"{type(error.cause).__name__}: {error.cause}"
            except ray.exceptions.RayError as error:
                yield job, f"its worker was lost ({type(error).__name__})"
