"""The tables of a study: Table 4 over training seeds, each seed, novel shapes, conditions."""

from collections.abc import Iterator, Sequence

import pandas as pd

from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import OVER_SEEDS
from minitouch_bench.protocol.minitouch import MAIN_SUITE, NOVEL_SHAPES
from minitouch_bench.records import Estimate
from minitouch_bench.rendering.tables import (
    Cell,
    Table,
    difference_cell,
    estimate_cell,
    make_columns,
    make_row,
)
from minitouch_bench.reporting import long_frame
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.paper import PAPER_NOTE
from minitouch_bench.reporting.tables import TABLE4_METRICS, table_by_task

SEEDS_NOTE = (
    f"95 % intervals: {OVER_SEEDS}. They describe training seeds on the suite's scenes. Where few "
    "seeds fail and others succeed they are too narrow. With one training seed they are over "
    "episodes only."
)

EPISODES_NOTE = "95 % intervals of the episodes of each training seed's policy."

CONDITIONS_NOTE = (
    "Without a sense: it stays as it is at the reset, a combination that no training contains. "
    "Change: the value less that of the same policy in the same episodes under standard "
    "conditions; over episodes the two count as independent. The standard row is of all episodes."
)


def study_tables(estimates: pd.DataFrame) -> Iterator[Table]:
    """Yield Table 4, the gaps on novel shapes, each training seed, and other conditions.

    Where a task has several lengths of exploration there are several of the first two: its
    shortest one is in the first table, the next one in the second.
    """
    metrics = dict.fromkeys(estimates["metric"])
    gaps = tuple(name for name in metrics if name.endswith(long_frame.GAP))
    for suite, title, shown in (
        (MAIN_SUITE, "Table 4", TABLE4_METRICS),
        (NOVEL_SHAPES, "Novel shapes", gaps),
    ):
        part = long_frame.select(estimates, suite=suite, conditions="")
        joined = long_frame.join_seeds(part[part["metric"].isin(shown)])
        turns = joined.groupby("task")["steps"].rank("dense")
        for turn in sorted({*turns}):
            name = f"{title}, exploration {turn:.0f} of {turns.max():.0f}"
            yield _table(name if turns.max() > 1 else title, shown, joined[turns == turn])
    main = long_frame.select(estimates, suite=MAIN_SUITE, conditions="")
    if len(main):
        yield _seeds_table(main)
    if estimates["conditions"].any():
        yield _conditions_table(
            long_frame.join_seeds(long_frame.select(estimates, suite=MAIN_SUITE))
        )


def _seeds_table(estimates: pd.DataFrame) -> Table:
    """Return exploration, and what ranks the task, of each training seed."""
    ranking = estimates["metric"] == estimates["task"].map(ranking_metric)
    part = estimates[ranking | (estimates["metric"] == "exploration")]
    named = part.sort_values("metric", kind="stable")[["metric", "task", "method", "steps"]]
    seeds = sorted({*part["seed"]})
    rows = []
    for metric, task, method, steps in dict.fromkeys(named.itertuples(index=False, name=None)):
        trained = long_frame.select(part, metric=metric, task=task, method=method, steps=steps)
        heads = (METRICS[metric].label, task_title(task), method, f"{steps:,}")
        values = (estimate_cell(metric, long_frame.find_row(trained, seed=one)) for one in seeds)
        rows.append(make_row(heads, *values))
    corner = ("Metric", "Task", "Method", "Exploration, control steps")
    columns = make_columns(*(f"seed {seed}" for seed in seeds))
    return Table("Training seeds", corner, columns, tuple(rows), (EPISODES_NOTE,))


def _conditions_table(joined: pd.DataFrame) -> Table:
    """Return what ranks a task under each condition, after the longest exploration.

    Of each condition there are two rows: the values, and what it changes.
    """
    longest = joined["steps"] == joined.groupby("task")["steps"].transform("max")
    changed = joined[joined["conditions"] != ""]
    played = joined["task"].isin(changed["task"]) & joined["method"].isin(changed["method"])
    names = joined["metric"].str.removesuffix(long_frame.CHANGE)
    shown = joined[longest & played & (names == joined["task"].map(ranking_metric))]
    methods = list(dict.fromkeys(shown["method"]))
    keys = shown[["task", "conditions", "metric"]].drop_duplicates()
    rows = []
    for task, conditions, metric in keys.itertuples(index=False, name=None):
        of_key = long_frame.select(shown, task=task, conditions=conditions, metric=metric)
        cells = (_cell(metric, long_frame.find_row(of_key, method=one)) for one in methods)
        label = metric.replace(ranking_metric(task), METRICS[ranking_metric(task)].label)
        rows.append(make_row((task_title(task), conditions or "standard", label), *cells))
    heads = ("Task", "Condition", "Metric")
    notes = (CONDITIONS_NOTE, SEEDS_NOTE)
    return Table("Other conditions", heads, make_columns(*methods), tuple(rows), notes)


def _cell(metric: str, estimate: Estimate | None) -> Cell:
    """Write an estimate, with a sign where it is a difference."""
    for suffix in (long_frame.GAP, long_frame.CHANGE):
        if estimate is not None and metric.endswith(suffix):
            return difference_cell(metric.removesuffix(suffix), estimate)
    return estimate_cell(metric, estimate)


def _table(title: str, metrics: Sequence[str], part: pd.DataFrame) -> Table:
    tasks, methods = (list(dict.fromkeys(part[column])) for column in ("task", "method"))
    lengths = dict(zip(part["task"], part["steps"], strict=True))
    explored = ", ".join(f"{task_title(task)} {steps:,}" for task, steps in lengths.items())
    with_paper = metrics is TABLE4_METRICS

    def cell(task: str, index: int, name: str) -> Cell:
        estimate = long_frame.find_row(part, task=task, method=methods[index], metric=name)
        return _cell(name, estimate)

    notes = (
        f"Control steps of exploration: {explored}.",
        SEEDS_NOTE,
        *((PAPER_NOTE,) * with_paper),
    )
    table = table_by_task(title, tasks, methods, metrics, cell, notes=notes, with_paper=with_paper)
    return table.filled_rows()
