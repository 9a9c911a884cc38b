"""Tables and sentences of a comparison and of a gate's result: each writer has the same ones."""

from collections.abc import Iterable, Sequence

from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.regression.comparison import (
    ComparedRun,
    Comparison,
    OutcomeChange,
    RunPair,
)
from minitouch_bench.regression.gate import NOT_ENOUGH_CODE, Decision, GateResult
from minitouch_bench.regression.paired_tests import Effect
from minitouch_bench.regression.pairing import COMPARED_METRICS
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.tables import (
    Cell,
    Column,
    Row,
    Table,
    difference_cell,
    format_value,
)
from minitouch_bench.reporting.labels import listed, task_title
from minitouch_bench.reporting.tables import OUTCOME_TITLES

SMALLEST_P = 0.0001
"""A p-value below is written as such: the bootstrap draws no finer ones."""

GATE_COLUMNS = (
    Column("Baseline"),
    Column("Candidate"),
    Column("Difference"),
)
ENDPOINT_COLUMNS = (
    *GATE_COLUMNS,
    Column("Tolerance"),
    Column("p"),
    Column("Decision", is_text=True),
)
TASK_COLUMNS = (*GATE_COLUMNS, Column("p adjusted"), Column("Verdict", is_text=True))

NOT_ALIKE = "Not alike beside the policies"


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


def endpoint_table(result: GateResult) -> Table:
    """Lay out what decides."""
    endpoint = result.endpoint
    effect = endpoint.effect
    tolerance = result.settings.tolerance_of(effect.metric)
    allowed = format_value(effect.metric, endpoint.tolerance)
    cells = (
        *_values(effect),
        Cell(f"{allowed} ({tolerance})" if tolerance.relative else allowed),
        Cell(p_text(endpoint.p_value)),
        Cell(endpoint.decision.value),
    )
    return Table(
        title=f"What decides: {effect_head(effect)}, over {listed(endpoint.tasks)}",
        corner=("Task",),
        columns=ENDPOINT_COLUMNS,
        rows=(Row((task_title(effect.task),), cells),),
    )


def task_tables(result: GateResult) -> tuple[Table, ...]:
    """Lay out the metrics of each task in narrow tables, one per metric: tasks down."""
    return tuple(_by_metric(TASK_COLUMNS, _task_rows(result)))


def task_table(result: GateResult) -> Table:
    """Lay out the metrics of each task, one row per metric of a task."""
    return Table(
        title="Candidate minus baseline, on the same episodes",
        corner=("Task", "Metric"),
        columns=TASK_COLUMNS,
        rows=tuple(
            Row((task_title(effect.task), effect_head(effect)), cells)
            for effect, cells in _task_rows(result)
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
            Column(f"Replay of {titles[1]}", is_text=True, is_code=True),
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


def effect_head(effect: Effect) -> str:
    """Name the metric of an effect with its better direction in the task, and its unit."""
    label = f"{METRICS[effect.metric].label} {effect.direction}".rstrip()
    return f"{label} ({effect.unit})"


def _task_rows(result: GateResult) -> list[tuple[Effect, tuple[Cell, ...]]]:
    """Return the cells of every metric of every task."""
    rows = []
    for one in result.per_task:
        tested = one.p_adjusted is not None
        words = ("worse" if one.is_worse else "not worse for certain") if tested else "not tested"
        p_value = Cell() if one.p_adjusted is None else Cell(p_text(one.p_adjusted))
        rows.append((one.effect, (*_values(one.effect), p_value, Cell(words))))
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


def run_line(run: ComparedRun) -> str:
    """Say which run a title stands for, and what must be known of it."""
    labels = f" ({'; '.join(run.labels)})" if run.labels else ""
    return f"{run.title.capitalize()}: {run.name}, {printable(run.path)}{labels}"


def comparison_lines(comparison: RunPair) -> tuple[str, ...]:
    """Say what holds for all of one run against the first."""
    found = []
    if comparison.identical:
        found.append("The run digests are equal: every episode is the same to the last bit.")
    found += [f"{NOT_ALIKE}: {note}." for note in comparison.notes]
    return tuple(found)


def comparison_notes(comparison: Comparison) -> tuple[str, ...]:
    """Say how the figures of a comparison were made."""
    percent = f"{100 * comparison.alpha:g} %"
    return (
        "Brackets and p: of this row alone. 95 % interval of the paired difference (Tango's score "
        "interval for shares of episodes, bootstrap-t for means; episode variance only), and the "
        "exact McNemar test, or sign flips and bootstrap-t. The interval is without 0 exactly "
        "where p is at most 5 %.",
        "p adjusted and verdict: over all rows of the metric (its tasks and runs) by Holm's "
        f"method, judged at {percent}. Not clear once adjusted: the row alone would show a "
        "difference, among so many rows it may be chance.",
        "Mean: over the tasks with a goal. A metric without an arrow has no better direction.",
        "Episodes to resolve: for a power of 80 % at 5 %, if the difference is as observed. "
        "Detectable: the difference that the present episodes show with that power.",
    )


def result_line(result: GateResult) -> str:
    """Say the gate's answer in one sentence that begins with the decision."""
    return f"{result.decision.value}: {_reason(result)}"


def _reason(result: GateResult) -> str:
    endpoint, effect = result.endpoint, result.endpoint.effect
    if result.identical:
        return "the run digests are equal, every episode is the same to the last bit"
    values = (format_value(effect.metric, value) for value in (effect.first, effect.second))
    change = f"{effect.task} {effect.metric} {' → '.join(values)}"
    where = "beyond" if endpoint.is_beyond else "within"
    seen = f"{change} in {effect.count} episodes, {where} the tolerance"
    if endpoint.decision is Decision.REGRESSION:
        return f"{seen}, p {p_text(endpoint.p_value)}"
    if endpoint.decision is Decision.NO_REGRESSION:
        return f"{change}, a worsening beyond the tolerance is excluded"
    if endpoint.episodes_needed is None:
        return f"{seen}; no number of episodes would settle it if the difference is as observed"
    return f"{seen}; {endpoint.episodes_needed:,} episodes per task would settle it"


def next_line(result: GateResult) -> str:
    """Say what to type next."""
    return f"next: {result.next_command}"


def episodes_line(result: GateResult) -> str:
    """Say how many episodes the answer took, "" where all were there already."""
    used = result.episodes_used
    if used is None:
        return ""
    saved = used.planned - used.used
    if saved == 0:
        return f"{used.used} of {used.planned} episodes were played; {used.reason}"
    share = 100 * saved / used.planned
    return (
        f"stopped after {used.used} of {used.planned} episodes, {share:.0f} % saved: {used.reason}"
    )


def gate_notes(result: GateResult) -> tuple[str, ...]:
    """Say how the figures of a result were made, and what is not alike."""
    found = [f"{NOT_ALIKE}: {note}." for note in result.notes]
    if result.unfinished:
        found.append(
            "The candidate's run is unfinished: differences and p are of the episodes seen; the "
            "decision is that of the whole run. The next command finishes it, then its episodes "
            "can be replayed."
        )
    alpha = f"{100 * result.settings.alpha:g} %"
    found.append(
        "Brackets: 95 % interval of the paired difference, of the row alone. p: one-sided, that "
        f"the candidate is no worse. Chance of a false regression: at most {alpha}. Only after a "
        "regression are the metrics of each task tested, adjusted together by Holm's method."
    )
    found.append(
        "regression: worse beyond the tolerance, and significant. no regression: the interval "
        "excludes a worsening beyond the tolerance. not enough episodes: neither; it fails "
        f"(exit {NOT_ENOUGH_CODE}) where the episodes seen are worse beyond the tolerance, with "
        "--strict always, with --lenient never."
    )
    return tuple(found)
