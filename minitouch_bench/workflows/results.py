"""A finished run as Python shows it: estimates as attributes, tables as DataFrames."""

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.records import Estimate, TaskSummary
from minitouch_bench.reporting.formats import as_text
from minitouch_bench.reporting.frames import episodes_frame
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.report import build_report
from minitouch_bench.reporting.run_tables import TABLE4_METRICS
from minitouch_bench.reporting.tables import Cell, Column, Row, Table, estimate_cell, metric_head
from minitouch_bench.reporting.writers import report_blocks
from minitouch_bench.runs import run as runs
from minitouch_bench.runs.run import RunHeader


@dataclass(frozen=True, repr=False)
class TaskResult:
    """The results of one task: each metric is an attribute, an estimate with its interval.

    ``result.success`` is an ``Estimate`` with ``value``, ``low``, ``high`` (95 %), ``count``
    and ``method``.
    """

    summary: TaskSummary

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The estimates by the name of their metric."""
        return dict(self.summary.estimates)

    @property
    def outcomes(self) -> dict[str, int]:
        """Number of episodes by how they ended."""
        return {outcome.value: count for outcome, count in self.summary.outcomes.items()}

    def to_frame(self) -> pd.DataFrame:
        """Return a row per metric: label, unit, value, low and high (95 %), count, method."""
        rows = {
            name: {"label": METRICS[name].label, "unit": METRICS[name].unit_in(self.summary.task)}
            | vars(estimate)
            for name, estimate in self.summary.estimates.items()
        }
        return pd.DataFrame.from_dict(rows, orient="index")

    def __str__(self) -> str:
        task = self.summary.task
        rows = tuple(
            Row(
                (metric_head(name, task),),
                (estimate_cell(name, one), Cell(METRICS[name].unit_in(task))),
            )
            for name, one in self.summary.estimates.items()
        )
        columns = (Column("Value"), Column("Unit", is_text=True))
        return as_text([Table(task_title(task), ("Metric",), columns, rows)])

    def __repr__(self) -> str:
        found = self.summary.estimates
        shown = [f"{name} {found[name]}" for name in TABLE4_METRICS if name in found]
        return f"<TaskResult of {self.summary.task}: {', '.join(shown)}>"

    def __getattr__(self, name: str) -> Estimate:
        estimates = self.__dict__["summary"].estimates if "summary" in self.__dict__ else {}
        if name not in estimates:
            raise AttributeError(f"no metric '{name}' here; there are {', '.join(estimates)}")
        found: Estimate = estimates[name]
        return found

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.summary.estimates})


@dataclass(frozen=True, repr=False)
class Run:
    """A finished run. ``run["pushing"]`` contains the estimates of a task.

    ``facts`` is the whole record, as ``run.json`` contains it.
    """

    facts: runs.Run

    @property
    def directory(self) -> Path | None:
        """The run's directory; None if it is in memory only."""
        return self.facts.directory

    @property
    def header(self) -> RunHeader:
        """What fixes the run's numbers: protocol, plan, policy, and why it is unofficial."""
        return self.facts.header

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks of the run."""
        return self.facts.plan.tasks

    @property
    def faults(self) -> dict[str, str]:
        """What the policy did wrong, by episode, as in ``pushing/17``."""
        return dict(self.facts.faults)

    @property
    def episodes(self) -> pd.DataFrame:
        """One row per episode, with the columns of ``episodes.csv``, family, split and digest."""
        return episodes_frame(self.facts.episodes)

    @property
    def exploration_episodes(self) -> pd.DataFrame:
        """The episodes of the exploration policy; no rows without one."""
        return episodes_frame(self.facts.exploration_episodes)

    def table4(self) -> pd.DataFrame:
        """Return Table 4 in the paper's shape: metrics as rows, tasks as groups of columns.

        Each task has the columns ``value``, ``low`` and ``high`` (95 %), NaN without estimate.
        """
        columns = {}
        for summary in self.facts.summary.tasks:
            found = [summary.estimates.get(name) for name in TABLE4_METRICS]
            for part in ("value", "low", "high"):
                values = [getattr(one, part) if one else float("nan") for one in found]
                columns[summary.task, part] = values
        names = pd.Index(TABLE4_METRICS, name="metric")
        return pd.DataFrame(columns, names)

    def __getitem__(self, task: str) -> TaskResult:
        for summary in self.facts.summary.tasks:
            if summary.task == task:
                return TaskResult(summary)
        raise KeyError(f"the run has no task '{task}'; it has {', '.join(self.tasks)}")

    def __str__(self) -> str:
        return as_text(report_blocks(build_report([self.facts])))

    def __repr__(self) -> str:
        header = self.header
        label = "official" if header.official else "unofficial"
        suite, tasks = header.plan.suite, ", ".join(self.tasks)
        return f"<Run of {header.policy.name} on {suite}, {label}: {tasks}>"
