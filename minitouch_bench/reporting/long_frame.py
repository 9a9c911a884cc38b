"""Estimates of several runs in one long frame, of which every report over runs is a selection.

A row per run, task and metric; ``join_seeds`` makes of it a row per method, task and metric.
"""

from collections.abc import Iterable
from dataclasses import astuple, dataclass
from typing import Any

import pandas as pd

from minitouch_bench.metrics.intervals import over_seeds
from minitouch_bench.metrics.summary import DIFFERENCE, GAP_PARTS
from minitouch_bench.records import Estimate
from minitouch_bench.runs.run import Run

KEY = ("method", "steps", "suite", "conditions", "task", "metric")
ESTIMATE = ("value", "low", "high", "count", "interval")
COLUMNS = ("method", "seed", *KEY[1:], *ESTIMATE)

GAP = f", {DIFFERENCE}"
"""What follows a metric's name where its value is a difference of splits."""

CHANGE = ", change"
"""What follows it where the value is the difference that other conditions make."""

FrameRow = tuple[Any, ...]


@dataclass(frozen=True)
class RunLabel:
    """What a run is in the frame: a training seed of a method, after so many training steps."""

    method: str
    seed: int
    steps: int


def repeats_policy(run: Run, other: Run) -> bool:
    """Tell whether two runs are of one policy in a task of both: they are not two seeds."""
    policies = {one.header.policy.digest or one.header.policy.source for one in (run, other)}
    return len(policies) == 1 and not {*run.plan.tasks}.isdisjoint(other.plan.tasks)


def frame_rows(label: RunLabel, run: Run) -> list[FrameRow]:
    """Return the rows of a run: the estimates of its ``run.json``, unchanged."""
    named = [
        (part.task, metric, estimate)
        for part in run.summary.tasks
        for metric, estimate in part.estimates.items()
    ]
    named += [
        (result.task, f"{metric}, {title}", getattr(gap, part))
        for result in run.summary.generalization
        for metric, gap in result.gaps.items()
        for part, title in GAP_PARTS.items()
    ]
    return [frame_row(label, run, *row) for row in named]


def frame_row(label: RunLabel, run: Run, task: str, metric: str, estimate: Estimate) -> FrameRow:
    """Return a row of the frame; ``conditions`` are "" where they are the protocol's own."""
    conditions = ", ".join(run.plan.conditions.in_words())
    return (*astuple(label), run.plan.suite, conditions, task, metric, *astuple(estimate))


def make_long_frame(rows: Iterable[FrameRow]) -> pd.DataFrame:
    """Return the frame, with ``COLUMNS``."""
    return pd.DataFrame([*rows], columns=[*COLUMNS])


def estimates_in(frame: pd.DataFrame) -> list[Estimate]:
    """Return the estimates of a frame's rows."""
    return [Estimate(*row) for row in frame[[*ESTIMATE]].itertuples(index=False, name=None)]


def join_seeds(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a row per ``KEY`` with its estimate over training seeds, in order of appearance."""
    rows = []
    for key, group in frame.groupby([*KEY], sort=False):
        estimate = over_seeds(estimates_in(group), str(key[-2]), str(key[-1]))
        if estimate is not None:
            rows.append((*key, *astuple(estimate)))
    return pd.DataFrame(rows, columns=[*KEY, *ESTIMATE])


def select(frame: pd.DataFrame, **values: object) -> pd.DataFrame:
    """Return the rows that have these values, by column."""
    for column, value in values.items():
        frame = frame[frame[column] == value]
    return frame


def find_row(frame: pd.DataFrame, **values: object) -> Estimate | None:
    """Return the estimate of the first row with these values, None where there is none."""
    return next(iter(estimates_in(select(frame, **values))), None)
