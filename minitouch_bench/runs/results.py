"""A run's numbers in Python: the estimates of a task as attributes, and tables as pandas frames."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from minitouch_bench.episode import Episode, Estimate, Summary, TaskSummary
from minitouch_bench.metrics.definitions import METRICS, ShownIn, metrics_shown_in

if TYPE_CHECKING:
    import pandas as pd

TABLE4_METRICS = metrics_shown_in(ShownIn.TABLE4)

_IDENTITY = ("task", "index", "seed", "shape", "outcome")
_MEASURED = tuple(metric for metric in METRICS.values() if metric.column)
EPISODE_COLUMNS = (*_IDENTITY, *(metric.column for metric in _MEASURED))
"""Columns of ``episodes.csv``."""

_BESIDE = ("family", "split", "digest")
"""What a frame of episodes has and ``episodes.csv`` has not."""


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

    def to_frame(self) -> "pd.DataFrame":
        """Return a row per metric: label, unit, value, low and high (95 %), count, method."""
        import pandas as pd  # noqa: PLC0415  takes half a second

        rows = {
            name: {"label": METRICS[name].label, "unit": METRICS[name].unit_in(self.summary.task)}
            | vars(estimate)
            for name, estimate in self.summary.estimates.items()
        }
        return pd.DataFrame.from_dict(rows, orient="index")

    def __str__(self) -> str:
        task = self.summary.task
        rows = [
            (
                f"{METRICS[name].label} {METRICS[name].direction_in(task)}".strip(),
                str(estimate),
                METRICS[name].unit_in(task),
            )
            for name, estimate in self.summary.estimates.items()
        ]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
        return "\n".join([task.capitalize(), *lines])

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


def episode_row(episode: Episode) -> tuple[Any, ...]:
    """Return the cells of an episode: EPISODE_COLUMNS."""
    return (
        *(getattr(episode, name) for name in _IDENTITY),
        *(metric.cell(episode) for metric in _MEASURED),
    )


def episodes_frame(episodes: Iterable[Episode]) -> "pd.DataFrame":
    """Return a row per episode: EPISODE_COLUMNS, family, split, digest; NaN for no time."""
    import pandas as pd  # noqa: PLC0415

    rows = [
        (*episode_row(episode), *(getattr(episode, name) for name in _BESIDE))
        for episode in episodes
    ]
    frame = pd.DataFrame(rows, columns=[*EPISODE_COLUMNS, *_BESIDE])
    frame["outcome"] = frame["outcome"].map(str)  # plain words, not members of the enumeration
    return frame.astype({"outcome": "str", "time_to_first_touch": "float64"})


def table4_frame(summary: Summary) -> "pd.DataFrame":
    """Return Table 4 in the paper's shape: metrics as rows, tasks as groups of columns.

    Each task has the columns ``value``, ``low`` and ``high`` (95 %), NaN without estimate.
    """
    import pandas as pd  # noqa: PLC0415

    columns = {}
    for part in summary.tasks:
        found = [part.estimates.get(name) for name in TABLE4_METRICS]
        for end in ("value", "low", "high"):
            values = [getattr(one, end) if one else float("nan") for one in found]
            columns[part.task, end] = values
    return pd.DataFrame(columns, pd.Index(TABLE4_METRICS, name="metric"))
