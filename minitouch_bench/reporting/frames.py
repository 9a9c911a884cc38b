"""A run's tables as CSV files, and its episodes as a pandas frame.

One row per episode; Table 4 and the gaps on novel shapes in long form.
"""

import csv
import io
from collections.abc import Iterable, Iterator
from dataclasses import astuple
from typing import TYPE_CHECKING, Any

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import GAP_PARTS
from minitouch_bench.records import EpisodeMetrics, Estimate, Generalization
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.labels import run_labels, tasks_in_order
from minitouch_bench.reporting.paper import CAVEAT, PAPER_METHODS, paper_value
from minitouch_bench.reporting.tables import TABLE4_METRICS, find_estimate
from minitouch_bench.runs.run import Run

if TYPE_CHECKING:
    import pandas as pd

_IDENTITY = ("task", "index", "seed", "shape", "outcome")
_MEASURED = tuple(metric for metric in METRICS.values() if metric.column)
EPISODE_COLUMNS = (*_IDENTITY, *(metric.column for metric in _MEASURED))
"""Columns of ``episodes.csv``."""

_BESIDE = ("family", "split", "digest")
"""What a frame of episodes has and ``episodes.csv`` has not."""

ESTIMATE_COLUMNS = ("value", "low", "high", "count", "method", "source")
TABLE4_COLUMNS = ("policy", "task", "metric", *ESTIMATE_COLUMNS)
GENERALIZATION_COLUMNS = ("policy", "task", "family", "metric", "split", *ESTIMATE_COLUMNS)

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
"""First characters that make a spreadsheet run a cell."""

CsvRow = tuple[Any, ...]


def episodes_frame(episodes: Iterable[EpisodeMetrics]) -> "pd.DataFrame":
    """Return a row per episode: EPISODE_COLUMNS, family, split, digest; NaN for no time."""
    import pandas as pd  # noqa: PLC0415  takes half a second

    rows = [
        (*_episode_row(episode), *(getattr(episode, name) for name in _BESIDE))
        for episode in episodes
    ]
    frame = pd.DataFrame(rows, columns=[*EPISODE_COLUMNS, *_BESIDE])
    frame["outcome"] = frame["outcome"].map(str)  # plain words, not members of the enumeration
    return frame.astype({"outcome": "str", "time_to_first_touch": "float64"})


def episodes_csv(episodes: Iterable[EpisodeMetrics]) -> str:
    """Write ``episodes.csv``."""
    return rows_csv(EPISODE_COLUMNS, map(_episode_row, episodes))


def _episode_row(episode: EpisodeMetrics) -> CsvRow:
    return (
        *(getattr(episode, name) for name in _IDENTITY),
        *(metric.cell(episode) for metric in _MEASURED),
    )


def table4_csv(run: Run) -> str:
    """Write Table 4 in long form; values that do not exist have no row.

    ``source`` carries the run's labels, and what must be known of the paper's values.
    """
    name, source = _name_and_source(run)
    rows: list[CsvRow] = []
    for task in tasks_in_order([run]):
        for metric in TABLE4_METRICS:
            if estimate := find_estimate(run, task, metric):
                rows.append((name, task, metric, *astuple(estimate), source))
            rows += _paper_rows(task, metric)
    return rows_csv(TABLE4_COLUMNS, rows)


def generalization_csv(run: Run) -> str:
    """Write held-out, train and their difference in long form, then each family's values.

    ``family`` is empty in a row over all families; values that do not exist have no row.
    """
    name, source = _name_and_source(run)
    rows = (
        (name, result.task, family, metric, split, *astuple(estimate), source)
        for result in run.summary.generalization
        for family, metric, split, estimate in _splits(result)
    )
    return rows_csv(GENERALIZATION_COLUMNS, rows)


def csv_text(frame: "pd.DataFrame") -> str:
    """Write a frame as ``rows_csv`` does; NaN is what does not exist."""
    there = frame.astype(object).where(frame.notna(), None)
    return rows_csv(frame.columns, there.to_numpy().tolist())


def rows_csv(columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Write rows as CSV, the same on every machine.

    Numbers in the shortest form that reads back the same, "true" and "false", an empty cell for
    what does not exist. A text that a spreadsheet would run as a formula gets an apostrophe.
    """
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(map(_cell, row) for row in rows)
    return written.getvalue()


def _cell(value: Any) -> Any:
    """Return what the writer of CSV takes for a value; it writes nothing for None."""
    if not isinstance(value, str):
        return str(value).lower() if isinstance(value, bool) else value
    # The guard looks at the raw text too: a leading tab is gone once it is printable.
    plain = printable(value)
    is_formula = any(text.startswith(FORMULA_STARTS) for text in (value, plain))
    return f"'{plain}" if is_formula else plain


def _splits(result: Generalization) -> Iterator[tuple[str, str, str, Estimate]]:
    for metric, gap in result.gaps.items():
        for part, split in GAP_PARTS.items():
            yield "", metric, split, getattr(gap, part)
    for family, both in result.families.items():
        for part, estimate in vars(both).items():
            if estimate is not None:
                yield family, result.family_metric, GAP_PARTS[part], estimate


def _paper_rows(task: str, metric: str) -> Iterator[CsvRow]:
    for method in PAPER_METHODS:
        printed = paper_value(task, metric, method)
        if printed is not None:
            source = f"paper ({', '.join(filter(None, (printed.remark, CAVEAT)))})"
            yield method, task, metric, float(printed.text), None, None, None, "", source


def _name_and_source(run: Run) -> tuple[str, str]:
    labels = "; ".join(run_labels(run))
    return printable(run.header.policy.name), f"run ({labels})" if labels else "run"
