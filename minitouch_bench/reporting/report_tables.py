"""The tables of a report as data, with their notes: Table 4, the diagnostics, novel shapes."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

from minitouch_bench.episode import Outcome
from minitouch_bench.metrics.definitions import (
    METRICS,
    NO_DIRECTION,
    UP,
    ShownIn,
    intervals_in_words,
    metrics_shown_in,
)
from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.metrics.summary import TABLE4_METRICS, Gap, Generalization, TaskResult
from minitouch_bench.reporting import labels
from minitouch_bench.reporting.labels import RunSection, estimate_cell, task_title
from minitouch_bench.reporting.tables import ABSENT, Cell, Column, Row, Table, make_columns
from minitouch_bench.runs.run import Run
from minitouch_bench.text import printable

DIAGNOSTIC_METRICS = metrics_shown_in(ShownIn.DIAGNOSTICS)

BEST_NOTE = (
    "Bold: the best of these runs in a task and metric, whether or not the difference is "
    "significant."
)

NO_DIFFERENCE = "no difference seen"
"""The verdict on a gap whose interval holds 0."""

OUTCOME_TITLES = {outcome: outcome.value.replace("_", " ") for outcome in Outcome}


def task_summary(run: Run, task: str) -> TaskResult | None:
    """Return a run's summary of a task, None if the run has no such task."""
    return next((summary for summary in run.summary.tasks if summary.task == task), None)


def find_estimate(run: Run, task: str, metric: str) -> Estimate | None:
    """Return a run's estimate, None where it has none."""
    summary = task_summary(run, task)
    return None if summary is None else summary.estimates.get(metric)


def find_generalization(run: Run, task: str) -> Generalization | None:
    """Return a run's comparison of the splits in a task, None if it has none."""
    return next((result for result in run.summary.generalization if result.task == task), None)


def table4(
    sections: Sequence[RunSection],
    tasks: Sequence[str],
    metrics: Sequence[str],
    *,
    with_paper: bool = True,
) -> Table:
    """Lay the runs out as Table 4: metrics down, tasks across, a column per policy.

    A task of which nothing is known has no columns.
    """
    printed = {
        task
        for task, metric in product(tasks, metrics)
        if with_paper and labels.paper_value(task, metric, "HaC")
    }
    methods = labels.PAPER_METHODS if printed else ()
    tasks = [
        task
        for task in tasks
        if task in printed
        or any(find_estimate(one.run, task, metric) for one in sections for metric in metrics)
    ]
    columns: list[Column] = []
    for task in tasks:
        columns += (Column(section.marked_name, task_title(task)) for section in sections)
        columns += (Column(one, task_title(task), is_paper=True) for one in methods)
    rows = []
    for metric in metrics:
        cells: list[Cell] = []
        for task in tasks:
            found = (find_estimate(section.run, task, metric) for section in sections)
            ours = [_cell_in(task, metric, estimate) for estimate in found]
            cells += mark_best(ours, METRICS[metric].direction_in(task))
            cells += (labels.paper_cell(task, metric, method) for method in methods)
        rows.append(Row((labels.metric_head(metric),), tuple(cells), _shared_unit(metric)))
    shown = [cell for row in rows for cell in row.cells]
    notes = (
        *_label_notes(sections),
        f"Brackets: 95 % interval, {intervals_in_words(TABLE4_METRICS)}; "
        "episode variance only (one training seed).",
        *([labels.PAPER_NOTE] if printed else []),
        *([labels.MARK_NOTE] if any(labels.MARK in cell.text for cell in shown) else []),
    )
    caption = BEST_NOTE if any(cell.is_best for cell in shown) else ""
    return Table("Table 4", ("Metric",), tuple(columns), tuple(rows), notes, caption)


def _shared_unit(metric: str) -> str:
    """Return the unit of a metric, "" where each task has its own, which ``_cell_in`` writes."""
    return "" if METRICS[metric].task_units else METRICS[metric].unit


def _cell_in(task: str, metric: str, estimate: Estimate | None) -> Cell:
    cell = estimate_cell(metric, estimate)
    if METRICS[metric].task_units and cell.text != ABSENT:
        return replace(cell, text=f"{cell.text} {METRICS[metric].unit_in(task)}")
    return cell


def mark_best(cells: Sequence[Cell], direction: str) -> list[Cell]:
    """Mark the best of several values as they are written; none where they are written alike."""
    known = [cell for cell in cells if cell.sort_key is not None]
    if direction == NO_DIRECTION or len({cell.text for cell in known}) < 2:
        return [*cells]
    best = (max if direction == UP else min)(known, key=lambda cell: cell.sort_key or 0.0)
    return [replace(cell, is_best=cell.text == best.text) for cell in cells]


def _label_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    return tuple(
        f"* {section.name}: {'; '.join(section.labels)}." for section in sections if section.labels
    )


def diagnostics(sections: Sequence[RunSection], tasks: Sequence[str]) -> Table:
    """Lay out what explains the values of Table 4: contact, time, and how episodes ended."""
    rows = []
    for task, section in product(tasks, sections):
        summary = task_summary(section.run, task)
        if summary is not None and summary.estimates:
            heads = (task_title(task), section.marked_name)
            rows.append(Row(heads, tuple(_diagnostic_cells(summary))))
    return Table(
        title="Diagnostics",
        corner=("Task", "Policy"),
        columns=(
            *(Column(METRICS[one].label, unit=_shared_unit(one)) for one in DIAGNOSTIC_METRICS),
            Column("Outcomes", unit="episodes", is_text=True),
            Column("Policy faults"),
        ),
        rows=tuple(rows),
        notes=(
            *_label_notes(sections),
            "First touch: mean over the episodes that touched. Object movement: variance over "
            "the episode of the object's position, or of the door's angle.",
            labels.force_note(tasks),
        ),
    )


def _diagnostic_cells(summary: TaskResult) -> Iterator[Cell]:
    for metric in DIAGNOSTIC_METRICS:
        yield _cell_in(summary.task, metric, summary.estimates.get(metric))
    ended = (
        f"{title} {summary.outcomes[outcome]}"
        for outcome, title in OUTCOME_TITLES.items()
        if summary.outcomes.get(outcome)
    )
    yield Cell(", ".join(ended) or ABSENT)
    yield Cell(str(summary.outcomes.get(Outcome.POLICY_FAULT, 0)))


def novel_shapes(sections: Sequence[RunSection], tasks: Sequence[str]) -> tuple[Table, ...]:
    """Lay out the gaps and the families of the runs that have both splits; none without one."""
    compared = [section for section in sections if section.run.summary.generalization]
    policy = ("Policy",) if len(compared) > 1 else ()
    gaps: list[Row] = []
    families: list[Row] = []
    for task, section in product(tasks, compared):
        if result := find_generalization(section.run, task):
            heads = (task_title(task), *((section.marked_name,) if policy else ()))
            gaps += _gap_rows(heads, result)
            families += _family_rows(heads, result)
    if not gaps:
        return ()
    labeled = _label_notes(compared)
    return (
        Table(
            "Novel shapes",
            ("Task", *policy, "Metric"),
            make_columns("Held-out", "Train", "Gap", "Verdict", words=("Verdict",)),
            tuple(gaps),
            (
                *labeled,
                "Held-out: shapes that training never sees. Gap: held-out minus train. Table 4 is "
                "over both. Brackets: 95 % interval; of a gap Newcombe's for shares, otherwise "
                "bootstrap over episodes.",
                f"“{NO_DIFFERENCE}”: the interval contains 0, which does not prove that there is "
                f"none. Each of the {len(gaps)} rows is judged by itself: where there is no gap at "
                "all, one interval in 20 still misses 0.",
            ),
        ),
        Table(
            "Novel shapes by family",
            ("Task", *policy, "Family"),
            make_columns("Held-out", "n", "Train", "n"),
            tuple(families),
            (*labeled, f"n: episodes. {ABSENT}: the run has no such shape in that split."),
        ),
    )


def _gap_rows(heads: tuple[str, ...], result: Generalization) -> Iterator[Row]:
    for name, gap in result.gaps.items():
        head = labels.metric_head(name, result.task)
        unit = METRICS[name].unit_in(result.task)
        yield Row((*heads, head), gap_cells(result.task, name, gap), unit)


def _family_rows(heads: tuple[str, ...], result: Generalization) -> Iterator[Row]:
    metric = METRICS[result.family_metric]
    task = f"{heads[0]}: {metric.label.lower()}"
    for family, both in result.families.items():
        cells: list[Cell] = []
        for estimate in (both.held_out, both.train):
            count = estimate.count if estimate else 0
            cells += (estimate_cell(metric.name, estimate), Cell(str(count)))
        yield Row((task, *heads[1:], printable(family)), tuple(cells), metric.unit)


def gap_cells(task: str, metric: str, gap: Gap) -> tuple[Cell, ...]:
    """Write one metric's held-out and train values, the gap and the verdict."""
    return (
        estimate_cell(metric, gap.held_out),
        estimate_cell(metric, gap.train),
        labels.difference_cell(metric, gap.difference),
        Cell(gap_in_words(task, metric, gap.difference)),
    )


def gap_in_words(task: str, metric: str, difference: Estimate) -> str:
    """Say in words what the interval of a gap allows to say."""
    if difference.low <= 0 <= difference.high:
        return NO_DIFFERENCE
    higher, direction = difference.low > 0, METRICS[metric].direction_in(task)
    if direction == NO_DIRECTION:
        return f"{'more' if higher else 'less'} on held-out"
    return f"{'better' if higher == (direction == UP) else 'worse'} on held-out"
