"""A run's episodes as CSV, and Table 4 in long form as CSV and JSON."""

import csv
import io
import json
from collections.abc import Iterable
from dataclasses import astuple
from itertools import product
from typing import TYPE_CHECKING, Any

from minitouch_bench.episode import Episode
from minitouch_bench.errors import printable
from minitouch_bench.reporting.labels import CAVEAT, PAPER_METHODS, paper_value
from minitouch_bench.reporting.run_tables import find_estimate
from minitouch_bench.runs.results import EPISODE_COLUMNS, episode_row

if TYPE_CHECKING:
    from minitouch_bench.reporting.report import Report

TABLE4_COLUMNS = (
    "policy", "task", "metric", "value", "low", "high", "count", "method", "source"
)  # fmt: skip

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
"""First characters that make a spreadsheet run a cell."""

CsvRow = tuple[Any, ...]


def episodes_csv(episodes: Iterable[Episode]) -> str:
    """Write ``episodes.csv``."""
    return rows_csv(EPISODE_COLUMNS, map(episode_row, episodes))


def table4_rows(report: "Report") -> list[dict[str, Any]]:
    """Return Table 4 in long form, with ``TABLE4_COLUMNS``; values that do not exist have no row.

    ``source`` carries a run's labels, and what must be known of the paper's values.
    """
    rows: list[CsvRow] = []
    for task, metric in product(report.tasks, report.metrics):
        for section in report.sections:
            labels = "; ".join(section.labels)
            if estimate := find_estimate(section.run, task, metric):
                source = f"run ({labels})" if labels else "run"
                rows.append((section.name, task, metric, *astuple(estimate), source))
        for method in PAPER_METHODS:
            printed = paper_value(task, metric, method)
            if printed is not None:
                source = f"paper ({', '.join(filter(None, (printed.remark, CAVEAT)))})"
                values = (float(printed.text), None, None, None, "")
                rows.append((method, task, metric, *values, source))
    return [dict(zip(TABLE4_COLUMNS, row, strict=True)) for row in rows]


def table4_csv(report: "Report") -> str:
    """Write Table 4 in long form."""
    return rows_csv(TABLE4_COLUMNS, (row.values() for row in table4_rows(report)))


def table4_json(report: "Report") -> str:
    """Write Table 4 in long form, a list of objects."""
    return json.dumps(table4_rows(report), indent=1, ensure_ascii=False) + "\n"


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
