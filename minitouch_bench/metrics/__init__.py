"""From an episode's trace to its metrics, and from episodes to estimates with intervals."""

from minitouch_bench.metrics.definitions import METRICS, Metric, unit_of
from minitouch_bench.metrics.episode import measure
from minitouch_bench.metrics.generalization import generalize
from minitouch_bench.metrics.intervals import (
    bootstrap_difference,
    bootstrap_mean,
    newcombe,
    wilson,
)
from minitouch_bench.metrics.summary import measure_run, summarize, summarize_episodes

__all__ = [
    "METRICS",
    "Metric",
    "bootstrap_difference",
    "bootstrap_mean",
    "generalize",
    "measure",
    "measure_run",
    "newcombe",
    "summarize",
    "summarize_episodes",
    "unit_of",
    "wilson",
]
