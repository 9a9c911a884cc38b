"""The paired test: how much a metric of a task differs between two runs of the same episodes.

Every difference that ``compare`` and ``regress`` show is of ``paired_test``, and computed once.
"""

from dataclasses import dataclass, replace

import numpy as np

from minitouch_bench.comparison.pairing import PairedValues
from minitouch_bench.metrics.definitions import DOWN, METRICS, UP
from minitouch_bench.metrics.intervals import Estimate, Root, stream
from minitouch_bench.metrics.significance import ALPHA
from minitouch_bench.metrics.statistics import Share

WORSE_SIGNS = {UP: -1.0, DOWN: 1.0}
"""Sign of a change for the worse, by a metric's better direction."""


@dataclass(frozen=True)
class Effect:
    """A metric in both runs over the same episodes, and second minus first.

    ``direction``: UP or DOWN where more or less is better in this task, else NO_DIRECTION.
    ``difference`` has a 95 % interval, which contains 0 where ``p_value`` > 0.05; both are of this
    metric and task alone. ``differing`` counts the episodes whose values are not equal.
    """

    task: str
    metric: str
    unit: str
    direction: str
    first: float
    second: float
    difference: Estimate
    p_value: float
    differing: int

    @property
    def count(self) -> int:
        """Number of paired episodes."""
        return self.difference.count

    @property
    def is_clear(self) -> bool:
        """Whether the test shows a difference and its interval excludes 0."""
        excludes_0 = self.difference.low > 0.0 or self.difference.high < 0.0
        return self.p_value <= ALPHA and excludes_0

    @property
    def worsening(self) -> float:
        """How much worse the second run is, in the metric's unit; negative if it is better.

        Raises:
            KeyError: the metric has no direction.
        """
        return self.difference.value * WORSE_SIGNS[self.direction]

    @property
    def worst(self) -> float:
        """The worsening at the worse end of the interval."""
        ends = (self.difference.low, self.difference.high)
        return max(end * WORSE_SIGNS[self.direction] for end in ends)


def is_binary(metric: str) -> bool:
    """Tell whether a metric is a share of episodes, so that its values are 0 and 1."""
    return isinstance(METRICS[metric].statistic, Share)


def paired_test(values: PairedValues, root: Root) -> Effect:
    """Estimate the difference of paired values and test it against 0, as their statistic does.

    Each (task, metric) draws from its own stream under ``root``.
    """
    statistic = METRICS[values.metric].statistic
    rng = stream(root, values.task, values.metric, "paired")
    result = statistic.paired_test(values.first, values.second, rng)
    return Effect(
        task=values.task,
        metric=values.metric,
        unit=METRICS[values.metric].unit_in(values.task),
        direction=values.direction,
        first=statistic.value(values.first),
        second=statistic.value(values.second),
        difference=_in_line(result.estimate, result.p_value),
        p_value=result.p_value,
        differing=int(np.count_nonzero(values.differences)),
    )


def _in_line(difference: Estimate, p_value: float) -> Estimate:
    """Widen an interval to 0 where its test, exact for few episodes, does not exclude 0."""
    if p_value <= ALPHA:
        return difference
    return replace(difference, low=min(difference.low, 0.0), high=max(difference.high, 0.0))
