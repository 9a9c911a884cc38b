"""Episodes on this machine, in worker processes."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.evaluation.engine import Engine, EngineOptions, Note
from minitouch_bench.evaluation.rollout import MAX_ATTEMPTS, ActorSource, EpisodeRunner
from minitouch_bench.processes import core_count, run_in_workers
from minitouch_bench.records import EpisodeRecord, EpisodeSpec


def open_local(
    options: EngineOptions,
    note: Note,  # noqa: ARG001 - an opener's signature
) -> contextlib.AbstractContextManager[Engine]:
    """Open the engine of this machine: see ``engine.ENGINES``."""
    return contextlib.nullcontext(LocalEngine(options.workers or core_count()))


class LocalEngine:
    """Runs each episode in one of ``workers`` processes."""

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(
        self, source: ActorSource, specs: Sequence[EpisodeSpec], attempts: Path | None = None
    ) -> Iterator[EpisodeRecord]:
        """Yield records as episodes end; a worker that dies is replaced, its episode retried.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy.
        """
        with TemporaryDirectory(prefix="minitouch-") as folder:
            records = run_in_workers(
                _RunEpisode(EpisodeRunner(source, attempts or Path(folder))),
                specs,
                self.workers,
                name=lambda spec: f"episode {spec.key}",
                attempts=MAX_ATTEMPTS,
            )
            for _, record in records:
                yield record


@dataclass(frozen=True)
class _RunEpisode:
    """Runs an episode in a worker. A policy's fault is a record: any error is the machine's."""

    runner: EpisodeRunner

    def __call__(self, spec: EpisodeSpec) -> EpisodeRecord:
        try:
            return self.runner.run(spec)
        except Exception as error:
            raise InfrastructureError(f"{type(error).__name__}: {error}") from error
