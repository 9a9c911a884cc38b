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
from minitouch_bench.reporting.tables import ABSENT, Cell, Column, Row, Table
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
    notes = (
        *_label_notes(sections),
        f"Brackets: 95 % interval, {intervals_in_words(TABLE4_METRICS)}; "
        "episode variance only (one training seed).",
        *([labels.PAPER_NOTE] if printed else []),
        *([labels.MARK_NOTE] if _has_mark(rows) else []),
    )
    has_best = any(cell.is_best for row in rows for cell in row.cells)
    caption = BEST_NOTE if has_best else ""
    return Table("Table 4", ("Metric",), tuple(columns), tuple(rows), notes, caption)


def _has_mark(rows: Sequence[Row]) -> bool:
    return any(labels.MARK in cell.text for row in rows for cell in row.cells)


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
    for task in tasks:
        for section in sections:
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
    results = [result for section in compared for result in section.run.summary.generalization]
    found = {result.task: result for result in results}
    tasks = [task for task in tasks if task in found]
    if not tasks:
        return ()
    return _gap_table(compared, tasks), _family_table(compared, [found[task] for task in tasks])


def _gap_table(sections: Sequence[RunSection], tasks: Sequence[str]) -> Table:
    """Lay out each metric on both splits, the gap and a verdict; a block per policy."""
    columns: list[Column] = []
    for section in sections:
        name = section.marked_name
        columns += (Column(label, name) for label in ("Held-out", "Train", "Gap"))
        columns.append(Column("Verdict", name, is_text=True))
    rows = []
    for task in tasks:
        found = [find_generalization(section.run, task) for section in sections]
        gaps = [result.gaps if result else {} for result in found]
        for metric in dict.fromkeys(name for one in gaps for name in one):
            cells = tuple(cell for one in gaps for cell in gap_cells(task, metric, one.get(metric)))
            heads = (task_title(task), labels.metric_head(metric, task))
            rows.append(Row(heads, cells, METRICS[metric].unit_in(task)))
    return Table(
        title="Novel shapes",
        corner=("Task", "Metric"),
        columns=tuple(columns),
        rows=tuple(rows),
        notes=(
            *_label_notes(sections),
            "Held-out: shapes that training never sees. Gap: held-out minus train. Table 4 is over "
            "both. Brackets: 95 % interval; of a gap Newcombe's for shares, otherwise bootstrap "
            "over episodes.",
            f"“{NO_DIFFERENCE}”: the interval contains 0, which does not prove that there is none. "
            f"Each of the {len(rows)} rows is judged by itself: where there is no gap at all, one "
            "interval in 20 still misses 0.",
        ),
    )


def gap_cells(task: str, metric: str, gap: Gap | None) -> tuple[Cell, ...]:
    """Write one metric's held-out and train values, the gap and the verdict."""
    if gap is None:
        return (Cell(),) * 4
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


def _family_table(sections: Sequence[RunSection], examples: Sequence[Generalization]) -> Table:
    """Lay out the families' values: families down, tasks across, a row per policy.

    ``examples``: for each task one run's result, which names the task and the metric.
    """
    columns: list[Column] = []
    for example in examples:
        metric = METRICS[example.family_metric]
        unit = "" if metric.is_fraction else f" ({metric.unit})"
        group = f"{task_title(example.task)}: {metric.label.lower()}{unit}"
        columns += (Column(label, group) for label in ("Held-out", "n", "Train", "n"))
    results = [result for section in sections for result in section.run.summary.generalization]
    single = len(sections) == 1
    rows = []
    for family in sorted({name for result in results for name in result.families}):
        for section in sections:
            heads = (printable(family),) if single else (printable(family), section.marked_name)
            found = (find_generalization(section.run, example.task) for example in examples)
            cells = (cell for result in found for cell in _family_cells(result, family))
            rows.append(Row(heads, tuple(cells)))
    return Table(
        title="Novel shapes by family",
        corner=("Family",) if single else ("Family", "Policy"),
        columns=tuple(columns),
        rows=tuple(rows),
        notes=(
            *_label_notes(sections),
            f"n: episodes. {ABSENT}: the run has no such shape in that split.",
        ),
    )


def _family_cells(result: Generalization | None, family: str) -> Iterator[Cell]:
    """Yield a family's value and number of episodes on held-out and on train shapes."""
    if result is None:
        yield from (Cell(),) * 4
        return
    both = result.families.get(family)
    for estimate in (both.held_out, both.train) if both else (None, None):
        yield estimate_cell(result.family_metric, estimate)
        yield Cell(str(estimate.count if estimate else 0))
