"""The tables of a report as data; each writer draws the same ones."""

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
from minitouch_bench.reporting.labels import run_labels, run_names, task_title, tasks_in_order
from minitouch_bench.reporting.paper import (
    CAVEAT,
    CITATION,
    OTHER_UNIT,
    PAPER_METHODS,
    PaperValue,
    paper_value,
)

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


def table4(runs: Sequence[SavedRun]) -> Table:
    """Lay the runs out as Table 4: metrics down, tasks across, a column a policy."""
    names = marked_names(runs)
    columns: list[Column] = []
    cells: dict[str, list[Cell]] = {metric: [] for metric in TABLE4_METRICS}
    for task in tasks_in_order(runs):
        group = task_title(task)
        columns += [Column(name, group) for name in names]
        columns += [Column(method, group, is_paper=True) for method in PAPER_METHODS]
        for metric, row in cells.items():
            row += [estimate_cell(metric, find_estimate(run, task, metric)) for run in runs]
            row += [paper_cell(paper_value(task, metric, method)) for method in PAPER_METHODS]
    rows = tuple(
        Row(
            heads=(metric_head(metric),),
            cells=tuple(row),
            unit=METRICS[metric].unit,
        )
        for metric, row in cells.items()
    )
    notes = (
        *label_notes(runs),
        *split_notes(runs),
        "Brackets: 95 % interval, Wilson for shares, bootstrap over episodes for means; "
        "episode variance only (one training seed).",
        f"{', '.join(PAPER_METHODS)}: the paper's own figures, {CAVEAT} ({CITATION}). "
        f"“{OTHER_UNIT}”: the paper does not say what it counts; never compare it with ours.",
    )
    return Table("Table 4", ("Metric",), tuple(columns), rows, notes)


def paper_cell(value: PaperValue | None) -> Cell:
    """Write a value of the paper as printed, without a number to sort by in another unit."""
    if value is None:
        return Cell()
    return Cell(value.text, value.remark, "as printed in the paper", value.number)


def diagnostics(runs: Sequence[SavedRun]) -> Table:
    """Lay out what explains the figures of Table 4: contact, time, and how episodes ended."""
    names = marked_names(runs)
    columns = tuple(
        Column(
            METRICS[metric].label, unit="" if METRICS[metric].task_units else METRICS[metric].unit
        )
        for metric in DIAGNOSTIC_METRICS
    )
    rows = []
    for task in tasks_in_order(runs):
        for name, run in zip(names, runs, strict=True):
            summary = task_summary(run, task)
            if summary is not None and summary.estimates:
                rows.append(Row((task_title(task), name), _diagnostic_cells(summary)))
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
            *label_notes(runs),
            "First touch: mean over the episodes that touched. Object movement: variance over "
            "the episode of the object's position, or of the door's angle.",
        ),
    )


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


def marked_names(runs: Sequence[SavedRun]) -> tuple[str, ...]:
    """Return the runs' names, with a * where a note below the table belongs to the run."""
    names = run_names(runs)
    return tuple(
        f"{name}\u00a0*" if run_labels(run) else name for name, run in zip(names, runs, strict=True)
    )


def label_notes(runs: Sequence[SavedRun]) -> tuple[str, ...]:
    """Return one note for each run that has labels."""
    return tuple(
        f"* {name}: {'; '.join(labels)}."
        for name, labels in zip(run_names(runs), map(run_labels, runs), strict=True)
        if labels
    )


def split_notes(runs: Sequence[SavedRun]) -> tuple[str, ...]:
    """Say that a figure is over both splits of a shape set, where one is."""
    mixed = [run for run in runs if has_both_splits(run.episodes)]
    if not mixed:
        return ()
    over = "Figures are over all shapes, held-out and train together"
    if any(run.summary.generalization for run in mixed):
        return (f"{over}; “Novel shapes” has them apart.",)
    return (f"{over}; a gap between the two needs {MIN_EPISODES} episodes of each.",)
