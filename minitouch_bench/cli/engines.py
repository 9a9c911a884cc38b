"""Where the episodes of an evaluation run: ``--engine``, ``--address`` and ``--workers``."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from enum import StrEnum
from typing import NamedTuple

from minitouch_bench.cli.consoles import notes
from minitouch_bench.cli.contests import AUTO, worker_count
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.engine import Engine
from minitouch_bench.evaluation.local_engine import LocalEngine
from minitouch_bench.evaluation.ray_cluster import check_address, ray_cluster
from minitouch_bench.evaluation.ray_engine import RayEngine


class EngineName(StrEnum):
    """The engines by name."""

    LOCAL = "local"
    RAY = "ray"


class Place(NamedTuple):
    """An engine that is ready, and how many episodes it runs at a time."""

    engine: Engine
    workers: int


def choose_engine(
    name: EngineName, address: str | None, workers: str
) -> AbstractContextManager[Place]:
    """Return what yields the engine asked for, and ends what was started for it.

    Entering it raises ``MissingExtraError`` where Ray is not installed, and
    ``InfrastructureError`` where there is no such cluster.

    Raises:
        UsageError: an option has no meaning here.
    """
    count = worker_count(workers)
    if name is EngineName.LOCAL:
        if address is not None:
            raise UsageError("--address is a Ray cluster's: add --engine ray")
        return nullcontext(Place(LocalEngine(count), count))
    if address is not None:
        check_address(address)
    return _on_ray(address, None if workers == AUTO else count)


@contextmanager
def _on_ray(address: str | None, workers: int | None) -> Iterator[Place]:
    with ray_cluster(address, workers) as ray:
        engine = RayEngine(ray, workers, lambda line: notes.print(line, markup=False))
        yield Place(engine, engine.workers)
