"""What one metric of one task differs by between two runs of the same episodes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.metric import DOWN
from minitouch_bench.metrics.streams import Root, stream
from minitouch_bench.records import Estimate
from minitouch_bench.regression.means import paired_mean
from minitouch_bench.regression.pairing import SHARE_METRICS, Sample
from minitouch_bench.regression.power import MeanResolution, Resolution, ShareResolution
from minitouch_bench.regression.shares import count_discordance, tango


@dataclass(frozen=True)
class Effect:
    """A metric in both runs over the same episodes, and second minus first.

    ``differing`` counts the episodes in which the two values are not equal.
    """

    task: str
    metric: str
    first: float
    second: float
    difference: Estimate
    p_value: float
    differing: int
    resolution: Resolution

    @property
    def count(self) -> int:
        """Number of paired episodes."""
        return self.difference.count

    @property
    def worsening(self) -> float:
        """How much worse the second run is, in the metric's unit; negative if it is better."""
        return self.difference.value * worse_sign(self.metric)

    @property
    def worst(self) -> float:
        """The worsening at the worse end of the interval."""
        ends = (self.difference.low, self.difference.high)
        return max(end * worse_sign(self.metric) for end in ends)


def worse_sign(metric: str) -> float:
    """Return 1 where more of a metric is worse, -1 where less is."""
    return 1.0 if METRICS[metric].direction == DOWN else -1.0


def measure_effect(sample: Sample, root: Root) -> Effect:
    """Estimate the difference of a sample and test it against 0.

    Each (task, metric) draws from its own stream under ``root``.
    """
    differences = sample.differences
    if sample.metric in SHARE_METRICS:
        found = count_discordance(sample.first, sample.second)
        difference, p_value = tango(found), found.p_value
        resolution: Resolution = ShareResolution(found)
    else:
        rng = stream(root, sample.task, sample.metric, "paired")
        difference, p_value = _of_means(sample, rng)
        resolution = MeanResolution(
            n=len(differences),
            worsening=float(differences.mean()) * worse_sign(sample.metric),
            deviation=float(differences.std(ddof=1)) if len(differences) > 1 else 0.0,
        )
    return Effect(
        task=sample.task,
        metric=sample.metric,
        first=float(sample.first.mean()),
        second=float(sample.second.mean()),
        difference=difference,
        p_value=p_value,
        differing=int(np.count_nonzero(differences)),
        resolution=resolution,
    )


def _of_means(sample: Sample, rng: np.random.Generator) -> tuple[Estimate, float]:
    found = paired_mean(sample.differences, rng)
    return found.estimate, found.p_value


def holm(p_values: Sequence[float]) -> tuple[float, ...]:
    """Return the p-values adjusted so that the chance of any false one stays at the level.

    Each keeps its index; an adjusted value is at least the one given and at most 1. scipy
    adjusts for false discoveries only.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J.
    Stat. 6 (1979).
    """
    order = np.argsort(p_values, kind="stable")
    scaled = np.asarray(p_values)[order] * np.arange(len(order), 0, -1)
    adjusted = np.empty(len(order))
    adjusted[order] = np.maximum.accumulate(np.minimum(scaled, 1.0))
    return tuple(adjusted.tolist())
