"""The tables of a comparison and of a gate's verdict as data; each writer draws the same ones."""

from collections.abc import Sequence

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.regression.comparison import Change, Entrant, Finding, Versus
from minitouch_bench.regression.effects import Effect
from minitouch_bench.regression.gate import Judgement, Ruling, Verdict
from minitouch_bench.regression.pairing import PAIRED_METRICS
from minitouch_bench.rendering.tables import (
    ABSENT,
    Cell,
    Column,
    Row,
    Table,
    format_value,
    metric_head,
)
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.tables import OUTCOME_TITLES

SMALLEST_P = 0.0001
"""A p-value below is written as such: the bootstrap draws no finer ones."""

VERDICT_COLUMNS = (
    Column("Baseline"),
    Column("Candidate"),
    Column("Difference"),
    Column("Tolerance"),
    Column("p"),
    Column("Judgement", is_text=True),
)


def comparison_tables(versus: Versus) -> tuple[Table, ...]:
    """Lay one run against the first, a table a metric: tasks down."""
    found = {
        metric: [one for one in versus.findings if one.effect.metric == metric]
        for metric in PAIRED_METRICS
    }
    return tuple(
        _metric_table(metric, rows, (versus.first, versus.second))
        for metric, rows in found.items()
        if rows
    )


def verdict_table(verdict: Verdict) -> Table:
    """Lay out what the gate judged, a row a metric of a task."""
    return Table(
        title="Candidate minus baseline, on the same episodes",
        corner=("Task", "Metric"),
        columns=VERDICT_COLUMNS,
        rows=tuple(
            Row(
                (task_title(one.effect.task), metric_label(one.effect.metric)),
                _judgement_cells(one, verdict),
            )
            for one in verdict.judgements
        ),
        notes=(),
    )


def verdict_tables(verdict: Verdict) -> tuple[Table, ...]:
    """Lay out what the gate judged in narrow tables, one a metric: tasks down."""
    found = {
        metric: [one for one in verdict.judgements if one.effect.metric == metric]
        for metric in PAIRED_METRICS
    }
    return tuple(
        Table(
            title=metric_label(metric),
            corner=("Task",),
            columns=VERDICT_COLUMNS,
            rows=tuple(
                Row((task_title(one.effect.task),), _judgement_cells(one, verdict)) for one in rows
            ),
            notes=(),
        )
        for metric, rows in found.items()
        if rows
    )


def changes_table(changes: Sequence[Change], names: tuple[str, str]) -> Table:
    """Lay out the episodes that ended in another way, with the command that replays each."""
    return Table(
        title="Episodes that ended in another way",
        corner=("Episode",),
        columns=(
            Column(names[0], is_text=True),
            Column(names[1], is_text=True),
            Column(f"Replay of {names[1]}", is_text=True),
        ),
        rows=tuple(
            Row(
                (change.key,),
                (
                    Cell(OUTCOME_TITLES[change.first]),
                    Cell(OUTCOME_TITLES[change.second]),
                    Cell(change.replays[1]),
                ),
            )
            for change in changes
        ),
        notes=(),
    )


def difference_text(effect: Effect) -> str:
    """Write a difference with its sign and its 95 % interval."""
    form = METRICS[effect.metric].number_format
    value, low, high = (
        _signed(end, form)
        for end in (effect.difference.value, effect.difference.low, effect.difference.high)
    )
    return f"{value} [{low}, {high}]"


def p_text(p_value: float) -> str:
    """Write a p-value."""
    return f"<{SMALLEST_P:.4f}" if p_value < SMALLEST_P else f"{p_value:.4f}"


def ruling_text(judgement: Judgement) -> str:
    """Write a ruling, with the episodes that would settle it."""
    if judgement.ruling is not Ruling.INCONCLUSIVE:
        return judgement.ruling.value
    if judgement.needed is None:
        return f"{judgement.ruling.value}, at the very tolerance"
    return f"{judgement.ruling.value}, needs {judgement.needed:,} episodes"


def metric_label(metric: str) -> str:
    """Write a metric with its better direction and its unit."""
    return f"{metric_head(metric)} ({METRICS[metric].unit})"


def _metric_table(
    metric: str, findings: Sequence[Finding], entrants: tuple[Entrant, Entrant]
) -> Table:
    one, other = (entrant.letter for entrant in entrants)
    form = METRICS[metric].number_format
    rows = []
    for finding in findings:
        effect = finding.effect
        rows.append(
            Row(
                (task_title(effect.task),),
                (
                    Cell(format_value(metric, effect.first)),
                    Cell(format_value(metric, effect.second)),
                    Cell(difference_text(effect)),
                    Cell(p_text(finding.p_holm)),
                    Cell(finding.verdict),
                    Cell(ABSENT if finding.needed is None else f"{finding.needed:,}"),
                    Cell(
                        ABSENT if finding.detectable is None else format(finding.detectable, form)
                    ),
                ),
            )
        )
    return Table(
        title=metric_label(metric),
        corner=("Task",),
        columns=(
            Column(one),
            Column(other),
            Column(f"{other} minus {one}"),
            Column("p"),
            Column("Verdict", is_text=True),
            Column("Episodes to resolve"),
            Column("Detectable"),
        ),
        rows=tuple(rows),
        notes=(),
    )


def _judgement_cells(judgement: Judgement, verdict: Verdict) -> tuple[Cell, ...]:
    effect = judgement.effect
    tolerance = verdict.settings.tolerance(effect.task, effect.metric)
    allowed = format_value(effect.metric, judgement.allowed)
    return (
        Cell(format_value(effect.metric, effect.first)),
        Cell(format_value(effect.metric, effect.second)),
        Cell(difference_text(effect)),
        Cell(f"{allowed} ({tolerance})" if tolerance.relative else allowed),
        Cell(p_text(judgement.p_value)),
        Cell(ruling_text(judgement)),
    )


def _signed(value: float, form: str) -> str:
    """Write a number with its sign; what rounds to 0 has none."""
    text = format(value, f"+{form}")
    return text[1:] if not any(digit in text for digit in "123456789") else text
