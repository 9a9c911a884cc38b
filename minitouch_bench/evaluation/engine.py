"""Engines: what runs episodes, and the one table of them."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from minitouch_bench.episode import EpisodeSpec, PlayedEpisode
from minitouch_bench.errors import (
    CheckpointChangedError,
    InfrastructureError,
    OutOfMemoryError,
    UsageError,
)
from minitouch_bench.processes import core_count, run_in_workers

if TYPE_CHECKING:
    from minitouch_bench.evaluation.rollout import EpisodeRunner, PolicyMaker


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
    """Functions that an evaluation or a training calls; each does nothing by default.

    ``note`` takes one line for the user. ``phase`` takes what begins now, in a word or two, and
    its number of episodes, of a training that of control steps; ``episode`` takes each episode of
    the phase as it ends. ``should_stop`` is asked after each episode that an evaluation has played,
    and before each control step of a training. Of a training alone: ``row`` takes each row of
    ``progress.csv``, a ``ProgressRow``.
    """

    note: Callable[[str], None] = ignore
    phase: Callable[[str, int], None] = ignore
    episode: Callable[[PlayedEpisode], None] = ignore
    row: Callable[[Any], None] = ignore
    should_stop: Callable[[], bool] = lambda: False

    def __post_init__(self) -> None:
        for name, given in vars(self).items():
            if not callable(given):
                raise UsageError(f"Callbacks: {name} is a function, not {given!r}")


SILENT = Callbacks()


def stopping_after(seconds: float | None, callbacks: Callbacks) -> Callbacks:
    """Return callbacks that stop an evaluation once so many seconds are over and an episode ends.

    With None nothing changes.

    Raises:
        UsageError: it is no time above 0.
    """
    if seconds is None:
        return callbacks
    if not seconds > 0:
        raise UsageError(f"stop_after is a time above 0 s, not {seconds}")
    end = time.monotonic() + seconds
    return replace(
        callbacks, should_stop=lambda: time.monotonic() >= end or callbacks.should_stop()
    )


Note = Callable[[str], None]
"""Takes one line for the user."""


class LocalEngine:
    """Runs each episode in one of ``workers`` processes."""

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(self, source: "PolicyMaker", specs: Sequence[EpisodeSpec]) -> Iterator[PlayedEpisode]:
        """Yield records as episodes end; a worker that dies is replaced, its episode retried.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy.
        """
        from minitouch_bench.evaluation.rollout import EpisodeRunner  # noqa: PLC0415  the simulator

        records = run_in_workers(
            partial(_run_episode, EpisodeRunner(source)),
            specs,
            self.workers,
            name=lambda spec: f"episode {spec.key}",
        )
        with closing(records):
            for _, record in records:
                yield record


def _run_episode(runner: "EpisodeRunner", spec: EpisodeSpec) -> PlayedEpisode:
    """Run an episode in a worker. A policy's fault is a record: any error is the machine's."""
    try:
        return runner.run(spec)
    except OutOfMemoryError as error:
        raise OutOfMemoryError(f"episode {spec.key}: {error}") from error
    except (CheckpointChangedError, InfrastructureError):
        raise
    except Exception as error:
        raise InfrastructureError(f"{type(error).__name__}: {error}") from error


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
