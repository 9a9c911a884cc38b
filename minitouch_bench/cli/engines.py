"""Where the episodes of an evaluation run: ``--engine``, ``--address`` and ``--workers``."""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from enum import StrEnum
from typing import NamedTuple

from minitouch_bench.cli.consoles import notes
from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.engine import Engine
from minitouch_bench.protocol.local_engine import LocalEngine
from minitouch_bench.protocol.ray_cluster import check_address, ray_cluster
from minitouch_bench.protocol.ray_engine import RayEngine

MAX_WORKERS = 1024
AUTO = "auto"


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
    count = _worker_count(workers)
    if name is EngineName.LOCAL:
        if address is not None:
            raise UsageError("--address is a Ray cluster's: add --engine ray")
        count = count or len(os.sched_getaffinity(0))
        return nullcontext(Place(LocalEngine(count), count))
    if address is not None:
        check_address(address)
    return _on_ray(address, count)


@contextmanager
def _on_ray(address: str | None, workers: int | None) -> Iterator[Place]:
    with ray_cluster(address, workers) as ray:
        engine = RayEngine(ray, workers, lambda line: notes.print(line, markup=False))
        yield Place(engine, engine.workers)


def _worker_count(text: str) -> int | None:
    """Return the number of workers; "auto" is none: as many as the place has processors for."""
    if text == AUTO:
        return None
    if not text.isdecimal() or not 1 <= int(text) <= MAX_WORKERS:
        raise UsageError(f"--workers is a number from 1 to {MAX_WORKERS}, or auto, not '{text}'")
    return int(text)
