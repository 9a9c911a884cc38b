"""The tables of a run on held-out and train shapes: the gap, and the families."""

from collections.abc import Iterable, Sequence

from minitouch_bench.metrics.definitions import METRICS, direction_of, unit_of
from minitouch_bench.metrics.metric import NO_DIRECTION, UP
from minitouch_bench.records import Estimate, FamilyResult, Gap, Generalization, SavedRun
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.tables import (
    ABSENT,
    Cell,
    Column,
    Row,
    Table,
    difference_cell,
    estimate_cell,
    metric_head,
)
from minitouch_bench.reporting.labels import RunSection, task_title, tasks_in_order
from minitouch_bench.reporting.tables import label_notes

NO_DIFFERENCE = "no difference seen"


def novel_shapes(sections: Sequence[RunSection]) -> tuple[Table, ...]:
    """Lay out the gaps and the families of the runs that have both splits; none without one."""
    compared = [section for section in sections if section.run.summary.generalization]
    if not compared:
        return ()
    return gap_table(compared), family_table(compared)


def gap_table(sections: Sequence[RunSection]) -> Table:
    """Lay out each metric on both splits, the gap and a verdict; a block per policy."""
    runs = [section.run for section in sections]
    columns: list[Column] = []
    for section in sections:
        name = section.marked_name
        columns += [Column(label, name) for label in ("Held-out", "Train", "Gap")]
        columns.append(Column("Verdict", name, is_text=True))
    rows = []
    for task in _tasks(runs):
        results = [find_generalization(run, task) for run in runs]
        for metric in _in_order(result.gaps for result in results if result):
            gaps = [result.gaps.get(metric) if result else None for result in results]
            cells = tuple(cell for gap in gaps for cell in gap_cells(task, metric, gap))
            heads = (task_title(task), metric_head(metric, task))
            rows.append(Row(heads, cells, unit_of(metric, task)))
    return Table(
        title="Novel shapes",
        corner=("Task", "Metric"),
        columns=tuple(columns),
        rows=tuple(rows),
        notes=(
            *label_notes(sections),
            "Held-out: shapes that training never sees. Gap: held-out minus train. Brackets: 95 % "
            "interval, Wilson for a share and Newcombe for the gap of two, else bootstrap over "
            "episodes.",
            f"“{NO_DIFFERENCE}”: the interval holds 0, which does not prove that there is none. "
            f"Each of the {len(rows)} rows is judged by itself: where there is no gap at all, one "
            "interval in 20 still misses 0.",
        ),
    )


def family_table(sections: Sequence[RunSection]) -> Table:
    """Lay out the families' values: families down, tasks across, a row per policy."""
    runs = [section.run for section in sections]
    tasks = _tasks(runs)
    columns: list[Column] = []
    for task in tasks:
        group = _family_group(runs, task)
        for split in ("Held-out", "Train"):
            columns += [Column(split, group), Column("n", group)]
    single = len(runs) == 1
    rows = []
    for family in sorted({name for run in runs for name in _families(run)}):
        for section in sections:
            heads = (printable(family),) if single else (printable(family), section.marked_name)
            cells = (cell for task in tasks for cell in _family_cells(section.run, task, family))
            rows.append(Row(heads, tuple(cells)))
    return Table(
        title="Novel shapes by family",
        corner=("Family",) if single else ("Family", "Policy"),
        columns=tuple(columns),
        rows=tuple(rows),
        notes=(
            *label_notes(sections),
            f"n: episodes. {ABSENT}: the run has no such shape in that split.",
        ),
    )


def find_generalization(run: SavedRun, task: str) -> Generalization | None:
    """Return a run's comparison of the splits in a task, None if it has none."""
    return next((result for result in run.summary.generalization if result.task == task), None)


def verdict(task: str, metric: str, difference: Estimate) -> str:
    """Say in words what the interval of a gap allows to say."""
    if difference.low <= 0 <= difference.high:
        return NO_DIFFERENCE
    higher, direction = difference.low > 0, direction_of(metric, task)
    if direction == NO_DIRECTION:
        return f"{'more' if higher else 'less'} on held-out"
    return f"{'better' if higher == (direction == UP) else 'worse'} on held-out"


def gap_cells(task: str, metric: str, gap: Gap | None) -> tuple[Cell, ...]:
    """Write one metric's held-out and train values, the gap and the verdict."""
    if gap is None:
        return (Cell(),) * 4
    return (
        estimate_cell(metric, gap.held_out),
        estimate_cell(metric, gap.train),
        difference_cell(metric, gap.difference),
        Cell(verdict(task, metric, gap.difference)),
    )


def _family_cells(run: SavedRun, task: str, family: str) -> tuple[Cell, ...]:
    """Write a family's figure and number of episodes on each split."""
    result = find_generalization(run, task)
    if result is None:
        return (Cell(),) * 4
    found = result.families.get(family, FamilyResult(None, None))
    cells = []
    for estimate in (found.held_out, found.train):
        cells.append(estimate_cell(result.family_metric, estimate))
        cells.append(Cell(str(estimate.count if estimate else 0)))
    return tuple(cells)


def _family_group(runs: Sequence[SavedRun], task: str) -> str:
    """Name a task's block by the task and the metric of its figures."""
    found = (find_generalization(run, task) for run in runs)
    metric = METRICS[next(result.family_metric for result in found if result)]
    unit = "" if metric.is_share else f" ({metric.unit})"
    return f"{task_title(task)}: {metric.label.lower()}{unit}"


def _families(run: SavedRun) -> tuple[str, ...]:
    """Return the families that a run has, in any task."""
    return _in_order(result.families for result in run.summary.generalization)


def _tasks(runs: Sequence[SavedRun]) -> tuple[str, ...]:
    """Return the tasks that any run compares, in the order of every table."""
    return tuple(
        task for task in tasks_in_order(runs) if any(find_generalization(run, task) for run in runs)
    )


def _in_order(groups: Iterable[Iterable[str]]) -> tuple[str, ...]:
    """Return the names of all groups, each once, in the order they come."""
    return tuple(dict.fromkeys(name for group in groups for name in group))
