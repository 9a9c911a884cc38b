"""Engines: what runs episodes, and the one table of them."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from minitouch_bench.episode import EpisodeSpec, PlayedEpisode
from minitouch_bench.errors import InfrastructureError, UsageError
from minitouch_bench.processes import core_count

if TYPE_CHECKING:
    from minitouch_bench.evaluation.rollout import PolicyMaker


class Engine(Protocol):
    """Runs episodes somewhere; their results depend on nothing but the episodes."""

    @property
    def workers(self) -> int:
        """How many episodes it runs at a time."""

    def run(self, source: "PolicyMaker", specs: Sequence[EpisodeSpec]) -> Iterator[PlayedEpisode]:
        """Yield one record per episode, in the order in which they end.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy.
        """


MAX_WORKERS = 1024
AUTO = "auto"

ENGINES: Mapping[str, str] = {
    "local": "on this machine",
    "ray": "on a Ray cluster, see docs/how-to/ray.md",
}
"""Where episodes can run, by the engine's name."""


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


def stopping_after(seconds: float | None, callbacks: Callbacks) -> Callbacks:
    """Return callbacks that end an evaluation once so many seconds are over and an episode ends.

    They raise an ``InfrastructureError``: what is done is kept, and the run can be resumed. With
    None nothing changes.
    """
    if seconds is None:
        return callbacks
    end = time.monotonic() + seconds

    def episode(record: PlayedEpisode) -> None:
        callbacks.episode(record)
        if time.monotonic() >= end:
            raise InfrastructureError("stopped: the time of --stop-after is over")

    return replace(callbacks, episode=episode)


Note = Callable[[str], None]
"""Takes one line for the user."""


def open_engine(
    name: str = "local", workers: int | str | None = AUTO, address: str | None = None
) -> AbstractContextManager[Engine]:
    """Return the context manager of an engine; entering it starts the engine.

    ``workers``: see ``worker_count``. ``address`` is that of a Ray cluster, by default one that is
    started here. Entering the context raises ``MissingExtraError`` where a package is not
    installed, and ``InfrastructureError`` where the engine cannot start.

    Raises:
        UsageError: no such engine, or an option has no meaning for it.
    """
    if name not in ENGINES:
        raise UsageError(f"no engine '{name}'; there are {', '.join(ENGINES)}")
    count = worker_count(workers)
    if name == "ray":
        from minitouch_bench.evaluation.ray_engine import open_ray  # noqa: PLC0415

        return open_ray(count, address)
    if address is not None:
        raise UsageError("--address is for another engine: add --engine ray")
    from minitouch_bench.evaluation.rollout import LocalEngine  # noqa: PLC0415  the simulator

    return nullcontext(LocalEngine(count or core_count()))


def worker_count(workers: int | str | None) -> int | None:
    """Return how many workers are asked for; None, as for "auto", stands for one per core.

    Raises:
        UsageError: it is not such a number of workers.
    """
    if workers in (None, AUTO):
        return None
    text = str(workers)
    if not text.isdecimal() or not 1 <= int(text) <= MAX_WORKERS:
        raise UsageError(f"--workers is a number from 1 to {MAX_WORKERS}, or auto, not '{text}'")
    return int(text)
