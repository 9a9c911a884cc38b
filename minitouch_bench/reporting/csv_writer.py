"""CSV files of a run: one row an episode; Table 4 and the gaps on novel shapes in long form."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence

from minitouch_bench.metrics.generalization import HELD_OUT, TRAIN
from minitouch_bench.records import EpisodeMetrics, Estimate, Generalization, SavedRun
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.labels import run_labels, run_names, tasks_in_order
from minitouch_bench.reporting.paper import CAVEAT, PAPER_METHODS, paper_value
from minitouch_bench.reporting.tables import TABLE4_METRICS, find_estimate

EPISODE_COLUMNS = {
    column: name
    for column, name in EpisodeMetrics.columns().items()
    if name not in ("family", "split", "digest")
}
"""Columns of ``episodes.csv`` with the field each holds; the rest stands in ``run.json`` alone."""

TABLE4_COLUMNS = (
    "policy",
    "task",
    "metric",
    "value",
    "low",
    "high",
    "count",
    "method",
    "source",
)
GENERALIZATION_COLUMNS = (
    "policy",
    "task",
    "family",
    "metric",
    "split",
    "value",
    "low",
    "high",
    "count",
    "method",
    "source",
)
DIFFERENCE = "held-out minus train"

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
"""First characters that make a spreadsheet run a cell."""

Cell = str | int | float | bool | None


def episodes_csv(episodes: Iterable[EpisodeMetrics]) -> str:
    """Write one row an episode; a time that does not exist is an empty cell."""
    return write_csv(tuple(EPISODE_COLUMNS), (_episode_row(episode) for episode in episodes))


def table4_csv(runs: Sequence[SavedRun]) -> str:
    """Write Table 4 in long form; figures that do not exist have no row."""
    rows: list[tuple[Cell, ...]] = []
    for task in tasks_in_order(runs):
        for metric in TABLE4_METRICS:
            rows += _run_rows(runs, task, metric)
            rows += _paper_rows(task, metric)
    return write_csv(TABLE4_COLUMNS, rows)


def generalization_csv(runs: Sequence[SavedRun]) -> str:
    """Write held-out, train and their difference in long form, then each family's figures.

    ``family`` is empty in a row over all families; figures that do not exist have no row.
    """
    rows: list[tuple[Cell, ...]] = []
    for name, run in zip(run_names(runs), runs, strict=True):
        for result in run.summary.generalization:
            for family, metric, split, found in _splits(result):
                interval = (found.value, found.low, found.high)
                place = (name, result.task, family, metric, split)
                rows.append((*place, *interval, found.count, found.method, _source(run)))
    return write_csv(GENERALIZATION_COLUMNS, rows)


def _splits(result: Generalization) -> Iterator[tuple[str, str, str, Estimate]]:
    """Walk through a task's estimates with their family, metric and split."""
    for metric, gap in result.gaps.items():
        yield "", metric, HELD_OUT, gap.held_out
        yield "", metric, TRAIN, gap.train
        yield "", metric, DIFFERENCE, gap.difference
    for family, found in result.families.items():
        for split, estimate in ((HELD_OUT, found.held_out), (TRAIN, found.train)):
            if estimate is not None:
                yield family, result.family_metric, split, estimate


def _source(run: SavedRun) -> str:
    """Say that a row is a run's, with the run's labels."""
    labels = "; ".join(run_labels(run))
    return f"run ({labels})" if labels else "run"


def _episode_row(episode: EpisodeMetrics) -> tuple[Cell, ...]:
    """Return an episode's cells in the order of EPISODE_COLUMNS."""
    return tuple(getattr(episode, name) for name in EPISODE_COLUMNS.values())


def _run_rows(runs: Sequence[SavedRun], task: str, metric: str) -> list[tuple[Cell, ...]]:
    """Return the runs' rows of one metric; ``source`` carries their labels."""
    rows: list[tuple[Cell, ...]] = []
    for name, run in zip(run_names(runs), runs, strict=True):
        found = find_estimate(run, task, metric)
        if found is not None:
            interval = (found.value, found.low, found.high)
            rows.append((name, task, metric, *interval, found.count, found.method, _source(run)))
    return rows


def _paper_rows(task: str, metric: str) -> list[tuple[Cell, ...]]:
    """Return the paper's rows of one metric."""
    rows: list[tuple[Cell, ...]] = []
    for method in PAPER_METHODS:
        printed = paper_value(task, metric, method)
        if printed is not None:
            value = float(printed.text)
            source = f"paper ({', '.join(filter(None, (printed.remark, CAVEAT)))})"
            rows.append((method, task, metric, value, None, None, None, "", source))
    return rows


def write_csv(columns: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """Write a CSV table with newlines of one form on every machine."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(cell) for cell in row] for row in rows)
    return text.getvalue()


def _cell(cell: Cell) -> str:
    """Write one cell; numbers in the shortest form that reads back the same."""
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "true" if cell else "false"
    if isinstance(cell, str):
        # The guard looks at the raw text too: a leading tab is gone once it is printable.
        guard = "'" if cell.startswith(FORMULA_STARTS) or _is_formula(printable(cell)) else ""
        return guard + printable(cell)
    return repr(cell)


def _is_formula(text: str) -> bool:
    """Tell whether a spreadsheet would run the text."""
    return text.startswith(FORMULA_STARTS)
