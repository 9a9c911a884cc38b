"""The metrics of one episode, from its record alone."""

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.records import EpisodeMetrics, EpisodeRecord


def measure(record: EpisodeRecord) -> EpisodeMetrics:
    """Measure one episode; a policy that failed before its first step gives zeros.

    Source: Table 4 and Figures 3 and 9 of the paper; ``docs/metrics.md`` defines each metric.
    """
    spec = record.spec
    measured = {
        metric.field or metric.name: metric.measure(record)
        for metric in METRICS.values()
        if metric.measure is not None
    }
    return EpisodeMetrics(
        task=spec.task,
        index=spec.index,
        seed=spec.seed,
        shape=spec.shape,
        family=spec.family,
        split=spec.split,
        outcome=record.outcome,
        digest=record.trace.digest(),
        **measured,  # type: ignore[arg-type]  # each measured as its field is typed
    )
