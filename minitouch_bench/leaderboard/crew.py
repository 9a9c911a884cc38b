"""Many small jobs on every core, few of them right here; results never depend on which."""

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Protocol, TypeVar

MANY = 64
"""Jobs from which on the start of worker processes is worth its second."""

CHUNK = 16

Job = TypeVar("Job")
Result = TypeVar("Result")


class Crew(Protocol):
    """Does one function to every job and returns the results in their order."""

    def __call__(self, function: Callable[[Job], Result], jobs: Iterable[Job]) -> list[Result]:
        """Do all of them."""


@contextmanager
def crew_for(count: int) -> Iterator[Crew]:
    """Yield a crew that suits this many jobs."""
    if count < MANY:
        yield lambda function, jobs: list(map(function, jobs))
        return
    workers = len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        yield lambda function, jobs: list(pool.map(function, jobs, chunksize=CHUNK))
