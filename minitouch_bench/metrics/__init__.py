"""From an episode's trace to its metrics, and from episodes to estimates with intervals."""

from minitouch_bench.metrics.definitions import (
    METRICS,
    direction_of,
    metrics_shown_in,
    ranking_metric,
    unit_of,
)
from minitouch_bench.metrics.intervals import (
    bootstrap_difference,
    bootstrap_mean,
    newcombe,
    wilson,
)
from minitouch_bench.metrics.metric import Metric, ShownIn
from minitouch_bench.metrics.summary import (
    generalize,
    measure,
    measure_run,
    summarize,
    summarize_episodes,
)

__all__ = [
    "METRICS",
    "Metric",
    "ShownIn",
    "bootstrap_difference",
    "bootstrap_mean",
    "direction_of",
    "generalize",
    "measure",
    "measure_run",
    "metrics_shown_in",
    "newcombe",
    "ranking_metric",
    "summarize",
    "summarize_episodes",
    "unit_of",
    "wilson",
]
