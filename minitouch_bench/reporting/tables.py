"""The tables of a report as data."""

from collections.abc import Sequence
from dataclasses import replace

from minitouch_bench.metrics.definitions import METRICS, metrics_shown_in, unit_of
from minitouch_bench.metrics.generalization import MIN_EPISODES, has_both_splits
from minitouch_bench.metrics.metric import ShownIn
from minitouch_bench.records import Estimate, Outcome, SavedRun, TaskSummary
from minitouch_bench.rendering.tables import (
    ABSENT,
    Cell,
    Column,
    Row,
    Table,
    estimate_cell,
    metric_head,
)
from minitouch_bench.reporting.labels import RunSection, task_title, tasks_in_order
from minitouch_bench.reporting.paper import PAPER_METHODS, PAPER_NOTE, paper_cell

TABLE4_METRICS = metrics_shown_in(ShownIn.TABLE4)
DIAGNOSTIC_METRICS = metrics_shown_in(ShownIn.DIAGNOSTICS)

OUTCOME_TITLES = {outcome: outcome.value.replace("_", " ") for outcome in Outcome}


def task_summary(run: SavedRun, task: str) -> TaskSummary | None:
    """Return a run's summary of a task, None if the run has no such task."""
    return next((summary for summary in run.summary.tasks if summary.task == task), None)


def find_estimate(run: SavedRun, task: str, metric: str) -> Estimate | None:
    """Return a run's estimate, None where it has none."""
    summary = task_summary(run, task)
    return None if summary is None else summary.estimates.get(metric)


def table4(sections: Sequence[RunSection]) -> Table:
    """Lay the runs out as Table 4: metrics down, tasks across, a column per policy."""
    columns: list[Column] = []
    cells: dict[str, list[Cell]] = {metric: [] for metric in TABLE4_METRICS}
    for task in tasks_in_order([section.run for section in sections]):
        group = task_title(task)
        columns += [Column(section.marked_name, group) for section in sections]
        columns += [Column(method, group, is_paper=True) for method in PAPER_METHODS]
        for metric, row in cells.items():
            found = (find_estimate(section.run, task, metric) for section in sections)
            row += [estimate_cell(metric, estimate) for estimate in found]
            row += [paper_cell(task, metric, method) for method in PAPER_METHODS]
    rows = tuple(
        Row((metric_head(metric),), tuple(row), METRICS[metric].unit)
        for metric, row in cells.items()
    )
    notes = (
        *label_notes(sections),
        *_split_notes(sections),
        "Brackets: 95 % interval, Wilson for shares, bootstrap over episodes for means; "
        "episode variance only (one training seed).",
        PAPER_NOTE,
    )
    return Table("Table 4", ("Metric",), tuple(columns), rows, notes)


def diagnostics(sections: Sequence[RunSection]) -> Table:
    """Lay out what explains the values of Table 4: contact, time, and how episodes ended."""
    columns = tuple(
        Column(
            METRICS[metric].label, unit="" if METRICS[metric].task_units else METRICS[metric].unit
        )
        for metric in DIAGNOSTIC_METRICS
    )
    rows = []
    for task in tasks_in_order([section.run for section in sections]):
        for section in sections:
            summary = task_summary(section.run, task)
            if summary is not None and summary.estimates:
                heads = (task_title(task), section.marked_name)
                rows.append(Row(heads, _diagnostic_cells(summary)))
    return Table(
        title="Diagnostics",
        corner=("Task", "Policy"),
        columns=(
            *columns,
            Column("Outcomes", unit="episodes", is_text=True),
            Column("Policy faults"),
        ),
        rows=tuple(rows),
        notes=(
            *label_notes(sections),
            "First touch: mean over the episodes that touched. Object movement: variance over "
            "the episode of the object's position, or of the door's angle.",
        ),
    )


def label_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    """Return one note for each run that has labels."""
    return tuple(f"* {one.name}: {'; '.join(one.labels)}." for one in sections if one.labels)


def _diagnostic_cells(summary: TaskSummary) -> tuple[Cell, ...]:
    """Write one row of the diagnostics."""
    cells = []
    for metric in DIAGNOSTIC_METRICS:
        cell = estimate_cell(metric, summary.estimates.get(metric))
        if METRICS[metric].task_units and cell.text != ABSENT:
            cell = replace(cell, text=f"{cell.text} {unit_of(metric, summary.task)}")
        cells.append(cell)
    ended = ", ".join(
        f"{title} {summary.outcomes[outcome]}"
        for outcome, title in OUTCOME_TITLES.items()
        if summary.outcomes.get(outcome)
    )
    faults = str(summary.outcomes.get(Outcome.POLICY_FAULT, 0))
    return (*cells, Cell(ended or ABSENT), Cell(faults))


def _split_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    """Say that a value is over both splits of a shape set, where one is."""
    mixed = [one.run for one in sections if has_both_splits(one.run.episodes)]
    if not mixed:
        return ()
    over = "Values are over all shapes, held-out and train together"
    if any(run.summary.generalization for run in mixed):
        return (f"{over}; “Novel shapes” has them apart.",)
    return (f"{over}; a gap between the two needs {MIN_EPISODES} episodes of each.",)
