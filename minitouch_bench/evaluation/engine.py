"""Engines: what runs episodes, and the one table of them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Protocol

from minitouch_bench.episode import EpisodeSpec, PlayedEpisode
from minitouch_bench.errors import UsageError

if TYPE_CHECKING:
    from minitouch_bench.evaluation.rollout import ActorSource


class Engine(Protocol):
    """Runs episodes somewhere; their results depend on nothing but the episodes."""

    @property
    def workers(self) -> int:
        """How many episodes it runs at a time."""

    def run(self, source: "ActorSource", specs: Sequence[EpisodeSpec]) -> Iterator[PlayedEpisode]:
        """Yield one record per episode, in the order in which they end.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy.
        """


MAX_WORKERS = 1024
AUTO = "auto"


@dataclass(frozen=True)
class EngineOptions:
    """Which engine to open. ``workers`` None: one per core; ``address``: of a cluster."""

    name: str = "local"
    workers: int | None = None
    address: str | None = None


def ignore(*_: object) -> None:
    """Do nothing."""


@dataclass(frozen=True)
class Callbacks:
    """Functions that an evaluation calls while it runs; each does nothing by default.

    ``note`` takes one line for the user. ``phase`` takes what begins now, in a word or two, and
    its number of episodes; ``episode`` takes each episode of the phase as it ends.
    """

    note: Callable[[str], None] = ignore
    phase: Callable[[str, int], None] = ignore
    episode: Callable[[PlayedEpisode], None] = ignore


SILENT = Callbacks()

Note = Callable[[str], None]
"""Takes one line for the user."""


@dataclass(frozen=True)
class EngineEntry:
    """What users read of an engine; ``address``: what ``--address`` is to it, "" for nothing."""

    about: str
    address: str = ""


ENGINES: Mapping[str, EngineEntry] = {
    "local": EngineEntry("on this machine"),
    "ray": EngineEntry(
        "on a Ray cluster, see docs/how-to/ray.md",
        address="the cluster; without it Ray starts here",
    ),
}
"""Each is a module ``evaluation/NAME_engine.py`` with ``open_engine``."""


def open_engine(options: EngineOptions) -> AbstractContextManager[Engine]:
    """Return the context manager of the engine asked for; entering it starts the engine.

    Entering it raises ``MissingExtraError`` where a package is not installed, and
    ``InfrastructureError`` where the engine cannot start.

    Raises:
        UsageError: no such engine, or an option has no meaning for it.
    """
    return _find_module(options).open_engine(options)  # type: ignore[no-any-return]


def _find_module(options: EngineOptions) -> ModuleType:
    if options.name not in ENGINES:
        raise UsageError(f"no engine '{options.name}'; there are {', '.join(ENGINES)}")
    workers = options.workers
    if workers is not None and not (isinstance(workers, int) and workers >= 1):
        raise UsageError(f"workers are {workers!r}; there can be 1 or more")
    if options.address is not None and not ENGINES[options.name].address:
        having = " or ".join(name for name, entry in ENGINES.items() if entry.address)
        raise UsageError(f"--address is for another engine: add --engine {having}")
    return import_module(f"{__package__}.{options.name}_engine")


def engine_options(engine: str, workers: int | str | None, address: str | None) -> EngineOptions:
    """Return the engine asked for; None and "auto" stand for one worker per core.

    Raises:
        UsageError: it is not such a number of workers.
    """
    if workers in (None, AUTO):
        return EngineOptions(engine, None, address)
    text = str(workers)
    if not text.isdecimal() or not 1 <= int(text) <= MAX_WORKERS:
        raise UsageError(f"--workers is a number from 1 to {MAX_WORKERS}, or auto, not '{text}'")
    return EngineOptions(engine, int(text), address)
