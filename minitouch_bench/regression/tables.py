"""The tables of a comparison and of a gate's result as data; each writer draws the same ones."""

from collections.abc import Iterable, Sequence

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.regression.comparison import OutcomeChange, RunPair, verdict
from minitouch_bench.regression.gate import Decision, GateResult, JudgedMetric
from minitouch_bench.regression.paired_tests import Effect
from minitouch_bench.regression.pairing import COMPARED_METRICS
from minitouch_bench.rendering.tables import (
    Cell,
    Column,
    Row,
    Table,
    difference_cell,
    format_value,
)
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.tables import OUTCOME_TITLES

SMALLEST_P = 0.0001
"""A p-value below is written as such: the bootstrap draws no finer ones."""

GATE_COLUMNS = (
    Column("Baseline"),
    Column("Candidate"),
    Column("Difference"),
    Column("Tolerance"),
    Column("p adjusted"),
    Column("Decision", is_text=True),
)


def comparison_tables(comparison: RunPair) -> tuple[Table, ...]:
    """Lay one run against the first, one table per metric: tasks down."""
    first, second = comparison.first, comparison.second
    columns = (
        Column(first),
        Column(second),
        Column(f"{second} minus {first}"),
        Column("p"),
        Column("p adjusted"),
        Column("Verdict", is_text=True),
        Column("Episodes to resolve"),
        Column("Detectable"),
    )
    rows = [
        (
            one.effect,
            (
                *_values(one.effect),
                Cell(p_text(one.effect.p_value)),
                Cell(p_text(one.p_adjusted)),
                Cell(one.verdict),
                Cell() if one.episodes_to_resolve is None else Cell(f"{one.episodes_to_resolve:,}"),
                Cell()
                if one.detectable is None
                else Cell(format_value(one.effect.metric, one.detectable)),
            ),
        )
        for one in comparison.metrics
    ]
    return tuple(_by_metric(columns, rows))


def gate_tables(result: GateResult) -> tuple[Table, ...]:
    """Lay out what the gate judged in narrow tables, one per metric: tasks down."""
    return tuple(_by_metric(GATE_COLUMNS, _gate_rows(result)))


def gate_table(result: GateResult) -> Table:
    """Lay out what the gate judged, one row per metric of a task."""
    return Table(
        title="Candidate minus baseline, on the same episodes",
        corner=("Task", "Metric"),
        columns=GATE_COLUMNS,
        rows=tuple(
            Row((task_title(effect.task), effect_head(effect)), cells)
            for effect, cells in _gate_rows(result)
        ),
    )


def changes_table(changes: Sequence[OutcomeChange], titles: tuple[str, str]) -> Table:
    """Lay out the episodes that ended in another way, with the command that replays each."""
    return Table(
        title="Episodes that ended in another way",
        corner=("Episode",),
        columns=(
            Column(titles[0], is_text=True),
            Column(titles[1], is_text=True),
            Column(f"Replay of {titles[1]}", is_text=True),
        ),
        rows=tuple(
            Row(
                (change.episode,),
                (
                    Cell(OUTCOME_TITLES[change.first]),
                    Cell(OUTCOME_TITLES[change.second]),
                    Cell(change.replays[1]),
                ),
            )
            for change in changes
        ),
    )


def difference_text(effect: Effect) -> str:
    """Write a difference with its sign and its 95 % interval."""
    return str(difference_cell(effect.metric, effect.difference))


def p_text(p_value: float) -> str:
    """Write a p-value."""
    return f"<{SMALLEST_P:.4f}" if p_value < SMALLEST_P else f"{p_value:.4f}"


def decision_text(judged: JudgedMetric) -> str:
    """Write a decision, with the episodes that would settle it."""
    if judged.decision is not Decision.INCONCLUSIVE:
        return judged.decision.value
    if judged.episodes_needed is None:
        return f"{judged.decision.value}, at the very tolerance"
    return f"{judged.decision.value}, needs {judged.episodes_needed:,} episodes"


def effect_head(effect: Effect) -> str:
    """Name the metric of an effect with its better direction in the task, and its unit."""
    label = f"{METRICS[effect.metric].label} {effect.direction}".rstrip()
    return f"{label} ({effect.unit})"


def _gate_rows(result: GateResult) -> list[tuple[Effect, tuple[Cell, ...]]]:
    """Return the cells of what was judged, then of what cannot get worse."""
    titles = (result.baseline.title, result.candidate.title)
    rows = []
    for one in result.judged:
        effect = one.effect
        tolerance = result.settings.tolerance(effect.task, effect.metric)
        allowed = format_value(effect.metric, one.tolerance)
        text = f"{allowed} ({tolerance})" if tolerance.relative else allowed
        tail = (Cell(text), Cell(p_text(one.p_adjusted)), Cell(decision_text(one)))
        rows.append((effect, (*_values(effect), *tail)))
    for effect in result.unjudged:
        words = verdict(effect, effect.p_value, titles)
        rows.append((effect, (*_values(effect), Cell(), Cell(), Cell(f"not judged: {words}"))))
    return rows


def _values(effect: Effect) -> tuple[Cell, ...]:
    """Return the cells of both values and their difference."""
    values = (format_value(effect.metric, value) for value in (effect.first, effect.second))
    return (*map(Cell, values), Cell(difference_text(effect)))


def _by_metric(
    columns: tuple[Column, ...], rows: Sequence[tuple[Effect, tuple[Cell, ...]]]
) -> Iterable[Table]:
    """Yield one table per metric and direction, in the metrics' order."""
    for metric in COMPARED_METRICS:
        own = [(effect, cells) for effect, cells in rows if effect.metric == metric]
        for head in dict.fromkeys(effect_head(effect) for effect, _ in own):
            listed = [(e, cells) for e, cells in own if effect_head(e) == head]
            yield Table(
                title=head,
                corner=("Task",),
                columns=columns,
                rows=tuple(Row((task_title(e.task),), cells) for e, cells in listed),
            )
