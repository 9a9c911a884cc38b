"""The tables of a report as data, with their notes: Table 4, the diagnostics, novel shapes."""

from collections.abc import Sequence
from dataclasses import replace

from minitouch_bench.episode import (
    Estimate,
    FamilyResult,
    Gap,
    Generalization,
    Outcome,
    TaskSummary,
)
from minitouch_bench.errors import printable
from minitouch_bench.metrics.definitions import (
    METRICS,
    NO_DIRECTION,
    UP,
    ShownIn,
    intervals_in_words,
    metrics_shown_in,
)
from minitouch_bench.metrics.summary import MIN_EPISODES, has_both_splits
from minitouch_bench.reporting import tables
from minitouch_bench.reporting.labels import (
    PAPER_METHODS,
    PAPER_NOTE,
    RunSection,
    paper_cell,
    task_title,
)
from minitouch_bench.runs.results import TABLE4_METRICS
from minitouch_bench.runs.run import Run

DIAGNOSTIC_METRICS = metrics_shown_in(ShownIn.DIAGNOSTICS)

EPISODE_METRICS = ("episode_steps", "return", "touch_interaction", "touch_share")
"""What a page shows of each episode."""

NO_DIFFERENCE = "no difference seen"
"""The verdict on a gap whose interval holds 0."""

OUTCOME_TITLES = {outcome: outcome.value.replace("_", " ") for outcome in Outcome}


def task_summary(run: Run, task: str) -> TaskSummary | None:
    """Return a run's summary of a task, None if the run has no such task."""
    return next((summary for summary in run.summary.tasks if summary.task == task), None)


def find_estimate(run: Run, task: str, metric: str) -> Estimate | None:
    """Return a run's estimate, None where it has none."""
    summary = task_summary(run, task)
    return None if summary is None else summary.estimates.get(metric)


def table4(
    sections: Sequence[RunSection],
    tasks: Sequence[str],
    metrics: Sequence[str] = TABLE4_METRICS,
) -> tables.Table:
    """Lay the runs out as Table 4: metrics down, tasks across, a column per policy."""
    names = [section.marked_name for section in sections]
    columns: list[tables.Column] = []
    for task in tasks:
        columns += (tables.Column(name, task_title(task)) for name in names)
        columns += (tables.Column(m, task_title(task), is_paper=True) for m in PAPER_METHODS)
    rows = []
    for metric in metrics:
        cells: list[tables.Cell] = []
        for task in tasks:
            found = (find_estimate(section.run, task, metric) for section in sections)
            cells += (tables.estimate_cell(metric, estimate) for estimate in found)
            cells += (paper_cell(task, metric, method) for method in PAPER_METHODS)
        rows.append(tables.Row((tables.metric_head(metric),), tuple(cells), METRICS[metric].unit))
    notes = (
        *_label_notes(sections),
        *_split_notes(sections),
        f"Brackets: 95 % interval, {intervals_in_words(TABLE4_METRICS)}; "
        "episode variance only (one training seed).",
        PAPER_NOTE,
    )
    return tables.Table("Table 4", ("Metric",), tuple(columns), tuple(rows), notes)


def _label_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    return tuple(
        f"* {section.name}: {'; '.join(section.labels)}." for section in sections if section.labels
    )


def _split_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    """Say that a value is over both splits of a shape set, where one is."""
    mixed = [section.run for section in sections if has_both_splits(section.run.rows)]
    if not mixed:
        return ()
    over = "Values are over all shapes, held-out and train together"
    if any(run.summary.generalization for run in mixed):
        return (f"{over}; “Novel shapes” has them apart.",)
    return (f"{over}; a gap between the two needs {MIN_EPISODES} episodes of each.",)


def diagnostics(sections: Sequence[RunSection], tasks: Sequence[str]) -> tables.Table:
    """Lay out what explains the values of Table 4: contact, time, and how episodes ended."""
    columns = tuple(
        tables.Column(
            METRICS[metric].label, unit="" if METRICS[metric].task_units else METRICS[metric].unit
        )
        for metric in DIAGNOSTIC_METRICS
    )
    rows = []
    for task in tasks:
        for section in sections:
            summary = task_summary(section.run, task)
            if summary is not None and summary.estimates:
                heads = (task_title(task), section.marked_name)
                rows.append(tables.Row(heads, _diagnostic_cells(summary)))
    return tables.Table(
        title="Diagnostics",
        corner=("Task", "Policy"),
        columns=(
            *columns,
            tables.Column("Outcomes", unit="episodes", is_text=True),
            tables.Column("Policy faults"),
        ),
        rows=tuple(rows),
        notes=(
            *_label_notes(sections),
            "First touch: mean over the episodes that touched. Object movement: variance over "
            "the episode of the object's position, or of the door's angle.",
        ),
    )


def _diagnostic_cells(summary: TaskSummary) -> tuple[tables.Cell, ...]:
    cells = []
    for metric in DIAGNOSTIC_METRICS:
        cell = tables.estimate_cell(metric, summary.estimates.get(metric))
        if METRICS[metric].task_units and cell.text != tables.ABSENT:
            cell = replace(cell, text=f"{cell.text} {METRICS[metric].unit_in(summary.task)}")
        cells.append(cell)
    ended = ", ".join(
        f"{title} {summary.outcomes[outcome]}"
        for outcome, title in OUTCOME_TITLES.items()
        if summary.outcomes.get(outcome)
    )
    faults = str(summary.outcomes.get(Outcome.POLICY_FAULT, 0))
    return (*cells, tables.Cell(ended or tables.ABSENT), tables.Cell(faults))


def episode_table(section: RunSection, tasks: Sequence[str]) -> tables.Table:
    """List a run's episodes, as ``replay`` calls them."""
    metrics = [METRICS[name] for name in EPISODE_METRICS]
    rows = []
    for episode in section.run.rows:
        if episode.task in tasks:
            values = ((metric, metric.value(episode)) for metric in metrics)
            texts = [_value_text(metric.name, value) for metric, value in values]
            name = printable(f"{episode.task}/{episode.index}")
            ended = OUTCOME_TITLES[episode.outcome]
            rows.append(tables.make_row(name, printable(episode.shape), ended, *texts))
    columns = (
        *tables.make_columns("Shape", "Outcome", words=("Shape", "Outcome")),
        *(tables.Column(metric.label, unit=metric.unit) for metric in metrics),
    )
    return tables.Table(f"Episodes of {section.name}", ("Episode",), columns, tuple(rows))


def _value_text(metric: str, value: float | None) -> str | None:
    """Write the value of one episode: a count without decimals."""
    if value is None:
        return None
    return tables.format_value(metric, value) if isinstance(value, float) else str(value)


def novel_shapes(sections: Sequence[RunSection], tasks: Sequence[str]) -> tuple[tables.Table, ...]:
    """Lay out the gaps and the families of the runs that have both splits; none without one."""
    compared = [section for section in sections if section.run.summary.generalization]
    runs = [section.run for section in compared]
    tasks = [task for task in tasks if any(find_generalization(run, task) for run in runs)]
    if not tasks:
        return ()
    return gap_table(compared, tasks), family_table(compared, tasks)


def gap_table(sections: Sequence[RunSection], tasks: Sequence[str]) -> tables.Table:
    """Lay out each metric on both splits, the gap and a verdict; a block per policy."""
    runs = [section.run for section in sections]
    columns: list[tables.Column] = []
    for section in sections:
        name = section.marked_name
        columns += [tables.Column(label, name) for label in ("Held-out", "Train", "Gap")]
        columns.append(tables.Column("Verdict", name, is_text=True))
    rows = []
    for task in tasks:
        results = [find_generalization(run, task) for run in runs]
        for metric in dict.fromkeys(name for result in results if result for name in result.gaps):
            gaps = [result.gaps.get(metric) if result else None for result in results]
            cells = tuple(cell for gap in gaps for cell in gap_cells(task, metric, gap))
            heads = (task_title(task), tables.metric_head(metric, task))
            rows.append(tables.Row(heads, cells, METRICS[metric].unit_in(task)))
    return tables.Table(
        title="Novel shapes",
        corner=("Task", "Metric"),
        columns=tuple(columns),
        rows=tuple(rows),
        notes=(
            *_label_notes(sections),
            "Held-out: shapes that training never sees. Gap: held-out minus train. Brackets: 95 % "
            "interval; of a gap Newcombe's for shares, otherwise bootstrap over episodes.",
            f"“{NO_DIFFERENCE}”: the interval contains 0, which does not prove that there is none. "
            f"Each of the {len(rows)} rows is judged by itself: where there is no gap at all, one "
            "interval in 20 still misses 0.",
        ),
    )


def family_table(sections: Sequence[RunSection], tasks: Sequence[str]) -> tables.Table:
    """Lay out the families' values: families down, tasks across, a row per policy."""
    runs = [section.run for section in sections]
    columns: list[tables.Column] = []
    for task in tasks:
        group = _family_group(runs, task)
        for split in ("Held-out", "Train"):
            columns += [tables.Column(split, group), tables.Column("n", group)]
    single = len(runs) == 1
    rows = []
    results = [result for run in runs for result in run.summary.generalization]
    for family in sorted({name for result in results for name in result.families}):
        for section in sections:
            heads = (printable(family),) if single else (printable(family), section.marked_name)
            cells = (cell for task in tasks for cell in _family_cells(section.run, task, family))
            rows.append(tables.Row(heads, tuple(cells)))
    return tables.Table(
        title="Novel shapes by family",
        corner=("Family",) if single else ("Family", "Policy"),
        columns=tuple(columns),
        rows=tuple(rows),
        notes=(
            *_label_notes(sections),
            f"n: episodes. {tables.ABSENT}: the run has no such shape in that split.",
        ),
    )


def find_generalization(run: Run, task: str) -> Generalization | None:
    """Return a run's comparison of the splits in a task, None if it has none."""
    return next((result for result in run.summary.generalization if result.task == task), None)


def verdict(task: str, metric: str, difference: Estimate) -> str:
    """Say in words what the interval of a gap allows to say."""
    if difference.low <= 0 <= difference.high:
        return NO_DIFFERENCE
    higher, direction = difference.low > 0, METRICS[metric].direction_in(task)
    if direction == NO_DIRECTION:
        return f"{'more' if higher else 'less'} on held-out"
    return f"{'better' if higher == (direction == UP) else 'worse'} on held-out"


def gap_cells(task: str, metric: str, gap: Gap | None) -> tuple[tables.Cell, ...]:
    """Write one metric's held-out and train values, the gap and the verdict."""
    if gap is None:
        return (tables.Cell(),) * 4
    return (
        tables.estimate_cell(metric, gap.held_out),
        tables.estimate_cell(metric, gap.train),
        tables.difference_cell(metric, gap.difference),
        tables.Cell(verdict(task, metric, gap.difference)),
    )


def _family_cells(run: Run, task: str, family: str) -> tuple[tables.Cell, ...]:
    result = find_generalization(run, task)
    if result is None:
        return (tables.Cell(),) * 4
    both = result.families.get(family, FamilyResult(None, None))
    cells = []
    for estimate in (both.held_out, both.train):
        cells.append(tables.estimate_cell(result.family_metric, estimate))
        cells.append(tables.Cell(str(estimate.count if estimate else 0)))
    return tuple(cells)


def _family_group(runs: Sequence[Run], task: str) -> str:
    """Name a task's block by the task and the metric of its figures."""
    results = (find_generalization(run, task) for run in runs)
    metric = METRICS[next(result.family_metric for result in results if result)]
    unit = "" if metric.is_share else f" ({metric.unit})"
    return f"{task_title(task)}: {metric.label.lower()}{unit}"
