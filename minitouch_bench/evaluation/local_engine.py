"""Episodes on this machine, in worker processes."""

import contextlib
from collections.abc import Iterator, Sequence
from functools import partial

from minitouch_bench.episode import EpisodeSpec, PlayedEpisode
from minitouch_bench.errors import InfrastructureError
from minitouch_bench.evaluation.engine import Engine, EngineOptions
from minitouch_bench.evaluation.rollout import ActorSource, EpisodeRunner
from minitouch_bench.processes import core_count, run_in_workers


def open_engine(options: EngineOptions) -> contextlib.AbstractContextManager[Engine]:
    """Open the engine of this machine."""
    return contextlib.nullcontext(LocalEngine(options.workers or core_count()))


class LocalEngine:
    """Runs each episode in one of ``workers`` processes."""

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(self, source: ActorSource, specs: Sequence[EpisodeSpec]) -> Iterator[PlayedEpisode]:
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


def _run_episode(runner: EpisodeRunner, spec: EpisodeSpec) -> PlayedEpisode:
    """Run an episode in a worker. A policy's fault is a record: any error is the machine's."""
    try:
        return runner.run(spec)
    except InfrastructureError:
        raise
    except Exception as error:
        raise InfrastructureError(f"{type(error).__name__}: {error}") from error
