"""What the output of ``compare`` and of ``regress`` have in common: effects, changes, runs."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

from minitouch_bench.comparison.pairing import COMPARED_METRICS, ComparedRun, Effect, OutcomeChange
from minitouch_bench.reporting import tables
from minitouch_bench.reporting.labels import (
    difference_cell,
    format_value,
    metric_head,
    task_title,
)
from minitouch_bench.reporting.report_tables import OUTCOME_TITLES
from minitouch_bench.text import printable

SMALLEST_P = 0.0001
"""A smaller p-value is written as "less than this one": the bootstrap is no finer."""

NOT_ALIKE = "The runs also differ beside the policies"

SHOWN_CHANGES = 20
"""Changed episodes that a screen lists; the JSON has all of them."""


def effect_row(effect: Effect, *cells: str | None) -> tables.Row:
    """Lay out a task's values in both runs, their difference, and more cells."""
    values = (format_value(effect.metric, value) for value in (effect.first, effect.second))
    difference = difference_cell(effect.metric, effect.difference)
    return tables.make_row(task_title(effect.task), *values, difference, *cells)


def tables_by_metric(
    columns: tuple[tables.Column, ...], rows: Sequence[tuple[Effect, *tuple[str | None, ...]]]
) -> Iterator[tables.Table]:
    """Yield a table for each metric, in the metrics' order, from effects and more cells."""
    heads = {effect_head(effect): effect.metric for effect, *_ in rows}
    for head in sorted(heads, key=lambda head: COMPARED_METRICS.index(heads[head])):
        of_head = tuple(effect_row(*row) for row in rows if effect_head(row[0]) == head)
        yield tables.Table(head, ("Task",), columns, of_head)


def changes_blocks(
    changes: Sequence[OutcomeChange], titles: tuple[str, str], most: int
) -> Iterator[tables.Block]:
    """Lay out the episodes that ended in another way, with the command that replays each."""
    if not changes:
        return
    columns = (
        *tables.make_columns(*titles, words=titles),
        tables.Column("Replay", is_text=True, is_code=True),
    )
    rows = tuple(
        tables.make_row(
            one.episode, OUTCOME_TITLES[one.first], OUTCOME_TITLES[one.second], one.replay
        )
        for one in changes[:most]
    )
    yield ""
    yield tables.Table("Episodes that ended in another way", ("Episode",), columns, rows)
    if (more := len(changes) - most) > 0:
        yield from ("", f"and {more} more; --json has all of them")


def difference_text(effect: Effect) -> str:
    """Write a difference with its sign and its 95 % interval."""
    return str(difference_cell(effect.metric, effect.difference))


def p_text(p_value: float) -> str:
    """Write a p-value."""
    return f"<{SMALLEST_P:.4f}" if p_value < SMALLEST_P else f"{p_value:.4f}"


def effect_head(effect: Effect) -> str:
    """Name the metric of an effect with its better direction in the task, and its unit."""
    return f"{metric_head(effect.metric, effect.task)} ({effect.unit})"


def run_line(run: ComparedRun) -> str:
    """Name the run that has a title, with its labels."""
    labels = f" ({'; '.join(run.labels)})" if run.labels else ""
    return f"{run.title.capitalize()}: {run.name}, {printable(run.path)}{labels}"


def json_text(document: dict[str, Any]) -> str:
    """Write a JSON document; NaN and infinity are refused."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
