"""From an episode's trace to its metrics, and from episodes to estimates with intervals."""

from minitouch_bench.metrics.definitions import METRICS, Metric, unit_of
from minitouch_bench.metrics.episode import measure
from minitouch_bench.metrics.intervals import bootstrap_mean, wilson
from minitouch_bench.metrics.summary import measure_run, summarize

__all__ = [
    "METRICS",
    "Metric",
    "bootstrap_mean",
    "measure",
    "measure_run",
    "summarize",
    "unit_of",
    "wilson",
]
