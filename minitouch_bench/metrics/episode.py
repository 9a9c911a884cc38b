"""The metrics of one episode, from its trace alone."""

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.records import (
    TICKS_PER_SECOND,
    EpisodeMetrics,
    EpisodeRecord,
    Outcome,
)

FORCE_COMPONENTS = slice(5, 11)
"""Columns of the touch vector that hold the two fingers' forces, N."""


def measure(record: EpisodeRecord) -> EpisodeMetrics:
    """Measure one episode; a policy that failed before its first step gives zeros.

    Source: Table 4 and Figures 3 and 9 of the paper; ``docs/metrics.md`` defines each.
    """
    spec, trace = record.spec, record.trace
    return EpisodeMetrics(
        task=spec.task,
        index=spec.index,
        seed=spec.seed,
        shape=spec.shape,
        family=spec.family,
        split=spec.split,
        outcome=record.outcome,
        success=record.outcome is Outcome.SUCCESS,
        steps=len(trace.actions),
        episode_return=float(trace.rewards.sum(dtype=np.float64)),
        touch_interaction=int(trace.contact_ticks.sum(dtype=np.int64)),
        touch_onsets=int(trace.onsets.sum(dtype=np.int64)),
        touch_steps=int(np.count_nonzero(trace.contact_ticks)),
        touch_variance=float(_axis_variances(trace.touch[:, FORCE_COMPONENTS]).mean()),
        object_movement=float(_axis_variances(trace.object_state).sum()),
        time_to_first_touch=_seconds(trace.first_touch_tick),
        arm_time=int(trace.ticks.sum(dtype=np.int64)) / TICKS_PER_SECOND,
        clipped_actions=int(np.count_nonzero(trace.clipped)),
        digest=trace.digest(),
    )


def _axis_variances(
    samples: NDArray[np.float32] | NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the population variance of each column of (N, D) samples, as (D,)."""
    if len(samples) == 0:
        return np.zeros(samples.shape[1])
    variances: NDArray[np.float64] = np.var(samples.astype(np.float64), axis=0)
    return variances


def _seconds(first_touch_tick: int) -> float | None:
    """Return the time of the first touch in s, None if there was none."""
    return None if first_touch_tick < 0 else first_touch_tick / TICKS_PER_SECOND
