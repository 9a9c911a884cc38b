"""Engines: what runs episodes and other jobs, and the one table of them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from minitouch_bench.errors import UsageError
from minitouch_bench.optional import look_up
from minitouch_bench.records import EpisodeRecord, EpisodeSpec

if TYPE_CHECKING:
    from minitouch_bench.evaluation.rollout import ActorSource


class Engine(Protocol):
    """Runs episodes somewhere; their results depend on nothing but the episodes."""

    @property
    def workers(self) -> int:
        """How many episodes it runs at a time."""

    def run(
        self, source: "ActorSource", specs: Sequence[EpisodeSpec], attempts: Path | None = None
    ) -> Iterator[EpisodeRecord]:
        """Yield one record per episode, in the order in which they end.

        ``attempts`` is a folder that keeps what attempts gave until their record is kept: see
        ``GivenActions``. Without one it is forgotten at the end.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy.
        """


@dataclass(frozen=True)
class EngineOptions:
    """Which engine to open. ``workers`` None: one per core; ``address``: of a cluster."""

    name: str = "local"
    workers: int | None = None
    address: str | None = None


LOCAL = EngineOptions()
"""One worker per core of this machine."""

Note = Callable[[str], None]
"""Takes one line for the user."""

Job = TypeVar("Job")
RunJobs = Callable[[EngineOptions, Callable[[Job], str], Sequence[Job]], Iterator[tuple[Job, str]]]
"""Calls a function on each job, each in a process with one thread and the processor's own kernels.

Yields each job that has ended with what went wrong, "" if nothing did. ``str(job)`` names it.
"""


@dataclass(frozen=True)
class EngineEntry:
    """What an engine runs by, as ``module:name``, and what users read of it.

    ``episodes`` takes ``EngineOptions`` and a ``Note``, and returns a context manager that yields
    the ``Engine`` and ends what was started for it. ``jobs`` is a ``RunJobs``, for the trainings
    of a study; "" where it runs none. ``address`` says what ``--address`` is to it; "" where it
    has none.
    """

    about: str
    episodes: str
    jobs: str = ""
    address: str = ""


ENGINES: Mapping[str, EngineEntry] = {
    "local": EngineEntry(
        "on this machine",
        episodes="minitouch_bench.evaluation.local_engine:open_local",
        jobs="minitouch_bench.evaluation.local_engine:run_jobs",
    ),
    "ray": EngineEntry(
        "on a Ray cluster, see docs/how-to/ray.md",
        episodes="minitouch_bench.evaluation.ray_engine:open_ray",
        jobs="minitouch_bench.evaluation.ray_engine:run_jobs",
        address="the cluster; without it Ray starts here",
    ),
}
STUDY_ENGINES = tuple(name for name, entry in ENGINES.items() if entry.jobs)


def find_engine(options: EngineOptions, names: Sequence[str] = tuple(ENGINES)) -> EngineEntry:
    """Return the engine asked for, one of ``names``.

    Raises:
        UsageError: there is none of that name, or an option has no meaning for it.
    """
    if options.name not in names:
        raise UsageError(f"no engine '{options.name}' here; there are {', '.join(names)}")
    workers = options.workers
    if workers is not None and not (isinstance(workers, int) and workers >= 1):
        raise UsageError(f"workers are {workers!r}; there can be 1 or more")
    entry = ENGINES[options.name]
    if options.address is not None and not entry.address:
        having = " or ".join(name for name in names if ENGINES[name].address)
        raise UsageError(f"--address is for another engine: add --engine {having}")
    return entry


def open_engine(
    options: EngineOptions, note: Note = lambda _: None
) -> AbstractContextManager[Engine]:
    """Return the context manager of the engine asked for; entering it starts the engine.

    Entering it raises ``MissingExtraError`` where a package is not installed, and
    ``InfrastructureError`` where the engine cannot start.

    Raises:
        UsageError: no such engine, or an option has no meaning for it.
    """
    opener: Any = look_up(find_engine(options).episodes)
    return opener(options, note)  # type: ignore[no-any-return]


def find_job_runner(options: EngineOptions) -> RunJobs[Any]:
    """Return what runs jobs on the engine asked for.

    Raises:
        UsageError: no such engine, or an option has no meaning for it.
    """
    runner: Any = look_up(find_engine(options, STUDY_ENGINES).jobs)
    return runner  # type: ignore[no-any-return]
